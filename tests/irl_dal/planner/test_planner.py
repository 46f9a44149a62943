import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from irl_dal.planner import PlannerConfig, TotalEnergy
from irl_dal.planner.projection import PROJECTION_MODES
from shield import Status
from tests.irl_dal.planner.scenes import (
    HORIZON,
    LIMITS,
    breaks_a_bound,
    context,
    lane,
    open_road,
    planner,
    random_context,
)


@pytest.mark.parametrize("sampler", ["ddim", "ddpm"])
@pytest.mark.parametrize("projection", PROJECTION_MODES)
def test_plans_are_admissible_in_every_mode_but_none(projection: str, sampler: str) -> None:
    """From any state, projected plans break no bound at all; pure diffusion does."""
    made = planner(projection=projection, sampler=sampler)
    rng = np.random.default_rng(0)
    broken = 0
    for _ in range(5):
        scene = random_context(rng)
        plan = made.plan(scene)
        assert plan.actions.shape == (HORIZON, 2)
        assert math.isfinite(plan.energy) and math.isfinite(plan.energy_nominal)
        broken += breaks_a_bound(plan.actions, scene.previous)
    assert broken == (5 if projection == "none" else 0)
    assert made.counts.total() == made.counts["plans"] == 5


def test_same_seed_same_plan() -> None:
    """Weights and samples come from the generator handed in, and from nothing else."""
    scene = context()
    first = planner(seed=1).plan(scene)
    torch.manual_seed(123)
    np.random.seed(5)
    again, other = planner(seed=1).plan(scene), planner(seed=2).plan(scene)
    np.testing.assert_array_equal(first.actions, again.actions)
    assert not np.array_equal(first.actions, other.actions)


def test_building_a_planner_leaves_torch_s_own_state_alone() -> None:
    """The global random state is the same before and after."""
    before = torch.get_rng_state()
    planner(seed=4).plan(context())
    assert torch.equal(before, torch.get_rng_state())


def test_the_modes_differ_only_in_the_projection() -> None:
    """`none` and `final` see the same network, guidance and noise: the same sample."""
    scene = context()
    pure, final = (planner(projection=mode).plan(scene) for mode in ("none", "final"))
    np.testing.assert_array_equal(pure.nominal, final.nominal)
    np.testing.assert_array_equal(pure.actions, pure.nominal)
    assert final.status is Status.PROJECTED
    assert (final.actions != final.nominal).any()


def test_the_best_of_the_candidates_is_taken() -> None:
    """Of sixteen candidates, all admissible, the plan is the one of least energy."""
    made = planner(candidates=16)
    scene = context(distance=4.0)
    plan = made.plan(scene)
    assert plan.candidates.shape == (16, HORIZON, 2)
    assert not any(breaks_a_bound(one, scene.previous) for one in plan.candidates)
    energy = TotalEnergy(scene, made.config.energy, LIMITS, HORIZON)
    energies = energy.value(LIMITS.to_action(plan.candidates))
    assert plan.energy == pytest.approx(float(energies.min()))
    np.testing.assert_array_equal(plan.actions, plan.candidates[int(energies.argmin())])


def test_wrong_reference_is_refused() -> None:
    """An expert reference of another horizon is a mistake of the caller."""
    with pytest.raises(ValueError, match=r"`expert_reference` must have shape \(8, 2\)"):
        planner().plan(replace(context(), expert_reference=np.zeros((4, 2))))


def test_expert_reference_attracts_the_plan() -> None:
    """With the same noise, a reference brings the plan nearer to it."""
    reference = np.tile([0.1, 4.0], (HORIZON, 1))
    far = open_road(lane=lane(valid=False))
    apart = [
        float(np.abs(planner(projection="none").plan(scene).actions - reference).mean())
        for scene in (far, replace(far, expert_reference=reference))
    ]
    assert apart[1] < apart[0]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("horizon", 7),
        ("horizon", 0),
        ("diffusion_steps", 1),
        ("schedule", "linear"),
        ("prediction", "v"),
        ("sampler", "euler"),
        ("sampling_steps", 101),
        ("width", 5),
        ("projection", "always"),
        ("candidates", 0),
        ("deadline", 0.0),
    ],
)
def test_config_refuses_nonsense(name: str, value: object) -> None:
    """Every impossible setting is refused by name and value."""
    with pytest.raises(ValueError, match=f"`{name}` must .* Got {value!r}"):
        PlannerConfig(**{name: value})  # type: ignore[arg-type]


def test_table_ii_is_the_default() -> None:
    """H = 8, T = 100 and w_g = 0.1 are the defaults."""
    config = PlannerConfig()
    assert (config.horizon, config.diffusion_steps, config.guidance.scale) == (8, 100, 0.1)
