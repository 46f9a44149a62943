"""Whatever goes wrong while planning, an admissible plan comes back in time."""

import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from irl_dal.planner import DiffusionPlanner, PlannerConfig, PlanningContext
from irl_dal.planner.projection import PROJECTION_MODES
from shield import ClearanceEstimate, LaneEstimate, Status
from tests.irl_dal.planner.scenes import (
    HORIZON,
    LIMITS,
    breaks_a_bound,
    context,
    lane,
    planner,
    random_context,
)


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
    assert plan.status is Status.FALLBACK and "not finite" in plan.reason
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


@lru_cache(maxsize=1)
def hasty() -> DiffusionPlanner:
    """A small planner, made where it is used: collecting the tests need not compile its code."""
    return planner(width=4, sampling_steps=2)


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
    plan = hasty().plan(scene)
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
    assert plan.status is Status.FALLBACK
    assert made.counts["fallback_sample"] == 1


def late_after(made: DiffusionPlanner) -> DiffusionPlanner:
    """A planner that is always too late, with another's last plan."""
    late = DiffusionPlanner(
        PlannerConfig(deadline=1e-9), LIMITS, generator=torch.Generator().manual_seed(0)
    )
    late._fallback, late._last_first = made._fallback, made._last_first
    return late


def test_a_passed_deadline_gives_the_last_plan_shifted_then_braking() -> None:
    """Too late: the rest of the last plan while it is followed, braking otherwise; counted."""
    made = planner()
    plan = made.plan(context())
    late = late_after(made)
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
    late = late_after(made)
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
    assert plan.status is Status.FALLBACK and plan.reason
    assert made.counts["fallback_projection"] == 1
    assert bool(np.all(np.abs(plan.actions[:, 0]) <= LIMITS.max_steering))


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
