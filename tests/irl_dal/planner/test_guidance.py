import math
from dataclasses import replace

import numpy as np
import pytest

from irl_dal.planner import EnergyConfig, GuidanceConfig, TotalEnergy
from irl_dal.planner.guidance import Guidance
from tests.irl_dal.planner.scenes import HORIZON, LIMITS, chunks, context, planner, random_context


def test_step_has_the_length_of_the_equation() -> None:
    """Each plan moves by w_g against its gradient, whatever the gradient's size."""
    rng = np.random.default_rng(0)
    scene = context(distance=3.0)
    energy = TotalEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
    actions = chunks(rng, scene, 4)
    moved = Guidance(energy, GuidanceConfig(epsilon=1e-6)).clean(actions, 0) - actions
    np.testing.assert_allclose(np.linalg.norm(moved.reshape(4, -1), axis=1), 0.1, rtol=1e-5)
    _, gradient = energy.evaluate(actions)
    assert bool(np.all(np.einsum("bhc,bhc->b", moved, gradient) < 0.0))


def test_a_small_step_lowers_the_energy() -> None:
    """Along the guidance the composite energy falls, on many states."""
    rng = np.random.default_rng(1)
    for _ in range(30):
        scene = random_context(rng)
        energy = TotalEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
        actions = chunks(rng, scene, 4)
        guided = Guidance(energy, GuidanceConfig(scale=1e-4)).clean(actions, 0)
        assert bool(np.all(energy.value(guided) < energy.value(actions)))


@pytest.mark.parametrize("iterations", [6, 0])
def test_a_final_line_search_never_raises_the_energy(iterations: int) -> None:
    """A full last step too long for the valley does; a shortened one lowers it or is not taken."""
    rng = np.random.default_rng(4)
    raised = moved = 0
    for _ in range(60):
        scene = random_context(rng)
        energy = TotalEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
        guidance = Guidance(energy, GuidanceConfig(scale=0.5, max_final_iterations=iterations))
        actions = chunks(rng, scene, 3)
        guided, before = guidance.finish(actions)
        np.testing.assert_array_equal(before, energy.value(actions))
        raised += int((energy.value(guided) > before).sum())
        moved += int(np.any(guided != actions, axis=(1, 2)).sum())
    assert (raised == 0) == (iterations > 0)
    assert moved > 150


def test_a_final_line_search_goes_on_while_the_energy_falls() -> None:
    """More iterations, less energy, up to the largest number; at the minimum none is taken."""
    scene = context(distance=1.0)
    energy = TotalEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
    actions = chunks(np.random.default_rng(0), scene, 3)
    reached = []
    for iterations in (1, 2, 6, 200):
        guidance = Guidance(energy, GuidanceConfig(max_final_iterations=iterations))
        guided, before = guidance.finish(actions)
        np.testing.assert_array_equal(before, energy.value(actions))
        reached.append(energy.value(guided))
    assert bool(np.all(np.diff(reached, axis=0) < 0))
    again, _ = Guidance(energy, GuidanceConfig()).finish(guided)
    assert bool(np.all(energy.value(again) > 0.9 * reached[-1]))


def test_guidance_that_is_switched_off_changes_nothing() -> None:
    """With a scale of zero both the estimates and the last one stay, and no energy is reported."""
    scene = context(distance=1.0)
    energy = TotalEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
    actions = chunks(np.random.default_rng(0), scene, 2)
    guidance = Guidance(energy, GuidanceConfig(scale=0.0))
    guided, before = guidance.finish(actions)
    np.testing.assert_array_equal(guidance.clean(actions, 0), actions)
    np.testing.assert_array_equal(guided, actions)
    assert bool(np.isnan(before).all())


def test_steps_shrink_with_a_small_gradient() -> None:
    """At the size of epsilon a step is half as long, far above it has its full length."""
    scene = context(distance=1.0)
    energy = TotalEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
    actions = chunks(np.random.default_rng(0), scene, 1)
    norm = float(np.linalg.norm(energy.evaluate(actions)[1]))
    for epsilon, share in ((norm, 0.5), (1e-3 * norm, 1.0)):
        moved = Guidance(energy, GuidanceConfig(epsilon=epsilon)).clean(actions, 0) - actions
        assert float(np.linalg.norm(moved)) == pytest.approx(0.1 * share, rel=2e-3)


def test_a_flat_energy_moves_nothing() -> None:
    """With no gradient the step is zero and finite."""
    scene = context()
    silent = EnergyConfig(lane_weight=0, clearance_weight=0, jerk_weight=0, stability_weight=0)
    actions = chunks(np.random.default_rng(0), scene, 2)
    guidance = Guidance(TotalEnergy(scene, silent, LIMITS, HORIZON), GuidanceConfig())
    np.testing.assert_array_equal(guidance.clean(actions, 0), actions)


def test_printed_energies_do_not_feel_lane_or_obstacle() -> None:
    """As printed an obstacle does not change the guidance step; rolled out it does."""
    rng = np.random.default_rng(2)
    near, far = context(distance=2.0), context(distance=39.0)
    far = replace(far, lane=replace(far.lane, lateral_offset=-0.5))
    actions = chunks(rng, near, 1)
    steps = {}
    for forms in ("printed", "rollout"):
        config = EnergyConfig(forms=forms)  # type: ignore[arg-type]
        steps[forms] = [
            Guidance(TotalEnergy(scene, config, LIMITS, HORIZON), GuidanceConfig()).clean(
                actions, 0
            )
            for scene in (near, far)
        ]
    np.testing.assert_allclose(*steps["printed"])
    assert float(np.abs(steps["rollout"][0] - steps["rollout"][1]).max()) > 1e-3


@pytest.mark.parametrize("projection", ["none", "x0"])
def test_guided_plans_have_lower_energy_than_unguided_ones(projection: str) -> None:
    """With the same noise, guidance lowers the mean energy of the plans over risky states."""
    energies = []
    for scale in (0.0, 0.1):
        guided = planner(projection=projection, guidance=GuidanceConfig(scale=scale), candidates=1)
        rng = np.random.default_rng(3)
        energies.append([guided.plan(random_context(rng)).energy for _ in range(40)])
    unguided_mean, guided_mean = np.mean(energies, axis=1)
    assert guided_mean < unguided_mean


@pytest.mark.parametrize(
    ("name", "value"),
    [("scale", -0.1), ("epsilon", 0.0), ("scale", math.nan), ("max_final_iterations", -1)],
)
def test_config_refuses_nonsense(name: str, value: float) -> None:
    """An impossible step is refused by name and value."""
    with pytest.raises(ValueError, match=f"`{name}` must .* Got {value}"):
        GuidanceConfig(**{name: value})
