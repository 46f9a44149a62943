import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from irl_dal.planner import (
    DiffusionPlanner,
    PlannerConfig,
    PlanningContext,
    TotalEnergy,
)
from irl_dal.planner.projection import PROJECTION_MODES
from shield import ClearanceEstimate, LaneEstimate, Status
from tests.irl_dal.planner.scenes import (
    HORIZON,
    LIMITS,
    context,
    lane,
    open_road,
    planner,
    random_context,
)


def breaks_a_bound(plan: np.ndarray, previous: np.ndarray) -> bool:
    """Whether a horizon is inadmissible from the last command on."""
    return any(
        LIMITS.violated(now, before)
        for now, before in zip(plan, [previous, *plan[:-1]], strict=True)
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


def spoiled(part: str) -> dict[str, Any]:
    """Changes that put something that is no number into a context."""
    scan = np.full(180, 40.0)
    scan[3] = math.nan
    return {
        "scan": {"scan": scan},
        "speed": {"speed": math.inf},
        "previous": {"previous": np.array([math.nan, 3.0])},
        "lane": {"lane": lane(lateral_offset=math.nan)},
    }[part]


@pytest.mark.parametrize("projection", PROJECTION_MODES)
@pytest.mark.parametrize("part", ["scan", "speed", "previous", "lane"])
def test_nan_in_the_context_gives_a_counted_fallback(part: str, projection: str) -> None:
    """What is no number never raises: an admissible fallback with a reason, counted."""
    made = planner(projection=projection)
    plan = made.plan(replace(context(), **spoiled(part)))
    assert plan.is_fallback and "not finite" in plan.reason
    assert made.counts == {"plans": 1, "fallback_context": 1}
    assert bool(np.isfinite(plan.actions).all())
    if part != "previous":
        assert not breaks_a_bound(plan.actions, context().previous)


@pytest.mark.parametrize("value", [1e300, -1e300, 1e-320])
def test_absurd_numbers_never_raise(value: float) -> None:
    """Finite but absurd values give a plan or a counted fallback, always finite and admissible."""
    made = planner()
    for changes in (
        {"speed": value},
        {"lane": lane(lateral_offset=value)},
        {"lane": lane(curvature=value)},
        {"scan": np.full(180, value)},
    ):
        scene = replace(context(), **changes)  # type: ignore[arg-type]
        plan = made.plan(scene)
        assert not breaks_a_bound(plan.actions, scene.previous)


NUMBERS = st.one_of(st.floats(), st.floats(-50.0, 50.0))
"""Any float64, half of the time one that could be meant."""

HASTY = planner(width=4, sampling_steps=2)


@settings(max_examples=200, deadline=None)
@given(
    scan=st.lists(NUMBERS, min_size=3, max_size=3),
    tracked=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.booleans()),
    pose=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.booleans()),
    speed=NUMBERS,
    previous=st.tuples(NUMBERS, NUMBERS),
)
def test_no_value_makes_planning_raise(
    scan: list[float],
    tracked: tuple[float, float, float, float, bool],
    pose: tuple[float, float, float, float, float, float, bool],
    speed: float,
    previous: tuple[float, float],
) -> None:
    """Whatever the numbers, a plan in the box comes back; from an admissible command all holds."""
    scene = PlanningContext(
        scan=np.tile(scan, 60),
        clearance=ClearanceEstimate(*tracked),
        lane=LaneEstimate(*pose),
        speed=speed,
        previous=np.array(previous),
    )
    plan = HASTY.plan(scene)
    assert plan.actions.shape == (HORIZON, 2)
    assert bool(np.all((plan.actions >= LIMITS.low) & (plan.actions <= LIMITS.high)))
    if LIMITS.is_admissible(previous):
        assert not breaks_a_bound(plan.actions, scene.previous)


def test_weights_that_diverged_give_a_fallback() -> None:
    """A network that predicts NaN is answered with the fallback and counted."""
    made = planner()
    with torch.no_grad():
        made.denoiser.out.bias.fill_(math.nan)
    plan = made.plan(context())
    assert plan.is_fallback
    assert made.counts["fallback_sample"] == 1


def test_a_passed_deadline_gives_the_last_plan_shifted_then_braking() -> None:
    """Too late: the rest of the last plan while it is followed, braking otherwise; counted."""
    made = planner()
    plan = made.plan(context())
    late = DiffusionPlanner(
        PlannerConfig(deadline=1e-9), LIMITS, generator=torch.Generator().manual_seed(0)
    )
    late._fallback, late._last_first = made._fallback, made._last_first
    followed = late.plan(replace(context(), previous=plan.actions[0]))
    np.testing.assert_array_equal(followed.actions[:-1], plan.actions[1:])
    assert "shifted" in followed.reason and followed.status is Status.FALLBACK
    elsewhere = late.plan(replace(context(), previous=np.array([0.0, 11.0])))
    assert "braking" in elsewhere.reason
    assert bool(np.all(np.diff(elsewhere.actions[:, 1]) < 0.0))
    late.reset()
    assert "braking" in late.plan(replace(context(), previous=plan.actions[1])).reason
    assert late.counts == {"plans": 3, "fallback_deadline": 3}


def test_a_plan_is_followed_within_one_rate_step_of_its_sign() -> None:
    """Further above the plan than the car can accelerate in a step, the plan was not followed."""
    made = planner()
    plan = made.plan(context())
    late = DiffusionPlanner(
        PlannerConfig(deadline=1e-9), LIMITS, generator=torch.Generator().manual_seed(0)
    )
    late._fallback, late._last_first = made._fallback, made._last_first
    rise, fall = LIMITS.max_increase[1], LIMITS.max_decrease[1]
    assert rise < fall
    for change, followed in ((0.9 * rise, True), (0.9 * fall, False), (-0.9 * fall, True)):
        previous = plan.actions[0] + [0.0, change]
        late._fallback.remember(plan.actions)
        late._last_first = plan.actions[0]
        reason = late.plan(replace(context(), previous=previous)).reason
        assert ("shifted" in reason) == followed, (change, reason)


def test_deadline_is_kept() -> None:
    """A plan that would take a hundred steps is given up within a step of its deadline."""
    slow = DiffusionPlanner(
        PlannerConfig(deadline=0.005, sampler="ddpm"),
        LIMITS,
        generator=torch.Generator().manual_seed(0),
    )
    latency = min(slow.plan(context()).latency for _ in range(5))
    assert slow.counts["fallback_deadline"] == 5
    assert latency < 0.02


def test_an_inadmissible_last_command_is_said_and_counted() -> None:
    """Where no plan keeps every bound, the plan approaches them and its status says so."""
    made = planner()
    plan = made.plan(replace(context(), previous=np.array([0.9, 6.0])))
    assert plan.is_fallback and plan.reason
    assert made.counts["fallback_projection"] == 1
    assert bool(np.all(np.abs(plan.actions[:, 0]) <= LIMITS.max_steering))


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


def test_loss_trains_the_network_and_the_next_plan_sees_it() -> None:
    """Gradient steps lower the loss, and planning uses the new weights at once."""
    made = planner(width=16)
    scene = context()
    rng = torch.Generator().manual_seed(0)
    contexts = torch.from_numpy(scene.encode()).expand(64, -1)
    target = torch.tensor([0.1, 0.2]) + 0.02 * torch.randn((64, HORIZON, 2), generator=rng)
    optimizer = torch.optim.Adam(made.parameters(), lr=1e-3)
    before = made.plan(scene).nominal
    losses = []
    for _ in range(60):
        loss = made.loss(contexts, target)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.mean(losses[-5:]) < 0.1 * losses[0]
    after = made.plan(scene).nominal
    target = LIMITS.to_command([0.1, 0.2])
    assert np.abs(after - target).mean() < 0.3 * np.abs(before - target).mean()


def test_written_weights_are_used_from_the_next_episode_on() -> None:
    """A weight written in place after a plan counts after `reset`."""
    made = planner(seed=1)
    plans = []
    for value in (None, 0.5):
        if value is not None:
            with torch.no_grad():
                made.denoiser.out.bias.fill_(value)
        made.reset()
        made.generator.manual_seed(9)
        plans.append(made.plan(context()).nominal)
    assert not np.array_equal(*plans)


def test_weights_travel() -> None:
    """A planner with another's weights makes another's plan, given the same noise."""
    first, second = planner(seed=1), planner(seed=2)
    second.plan(context())
    second.load_state_dict(first.state_dict())
    for made in (first, second):
        made.generator.manual_seed(9)
    plans = [made.plan(context()) for made in (first, second)]
    np.testing.assert_array_equal(plans[0].nominal, plans[1].nominal)
    assert len(list(first.parameters())) == len(first.state_dict())


def test_loss_refuses_wrong_shapes() -> None:
    """Contexts and chunks of the wrong size are refused by name."""
    made = planner()
    with pytest.raises(ValueError, match=r"`contexts` must be \(4, 64\). Got \(4, 63\)"):
        made.loss(torch.zeros(4, 63), torch.zeros(4, 8, 2))
    with pytest.raises(ValueError, match=r"`chunks` must be \(4, 8, 2\). Got \(4, 6, 2\)"):
        made.loss(torch.zeros(4, 64), torch.zeros(4, 6, 2))


@pytest.mark.parametrize("prediction", ["x0", "epsilon"])
def test_loss_of_a_perfect_network_is_zero(
    prediction: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loss compares with the clean chunk or with the noise, at the level it was noised to."""
    made = planner(prediction=prediction)
    chunks = torch.full((32, HORIZON, 2), 0.3)
    bar = torch.tensor(made._schedule.alpha_bar, dtype=torch.float32)

    def perfect(noisy: torch.Tensor, k: torch.Tensor, contexts: torch.Tensor) -> torch.Tensor:
        kept = bar[k][:, None, None]
        return chunks if prediction == "x0" else (noisy - kept.sqrt() * chunks) / (1 - kept).sqrt()

    monkeypatch.setattr(made, "denoiser", perfect)
    loss = made.loss(torch.zeros(32, 64), chunks)
    assert float(loss) < 1e-8


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


def test_without_a_deadline_a_busy_machine_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """In simulated time a projection that is slow on the wall clock still gets its answer."""
    plans = []
    for pause in (0.0, 0.03):
        made = planner(deadline=None, sampling_steps=2)
        solver = made._projector._solver
        original = type(solver).solve

        def slow(
            self: object,
            *arguments: object,
            pause: float = pause,
            solve: Any = original,
            **options: object,
        ) -> Any:
            time.sleep(pause)
            return solve(self, *arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(type(solver), "solve", slow)
            plans.append([made.plan(random_context(np.random.default_rng(i))) for i in range(6)])
    for quick, late in zip(*plans, strict=True):
        np.testing.assert_array_equal(quick.actions, late.actions)
        assert quick.status == late.status


@pytest.mark.slow
def test_no_plan_is_late_because_of_a_compiler(tmp_path: Path) -> None:
    """In a process whose compiled code is not kept anywhere yet, the first plan is in time."""
    script = (
        "import torch; from tests.irl_dal.planner.scenes import context, planner;"
        "made = planner(deadline=1.0); plan = made.plan(context());"
        "print(made.counts['fallback_deadline'], plan.latency)"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    late, latency = done.stdout.split()
    assert late == "0" and float(latency) < 1.0
