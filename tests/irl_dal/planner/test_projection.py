import numpy as np
import pytest
from numpy.typing import NDArray

from irl_dal.planner.projection import (
    PROJECTION_MODES,
    PlanProjection,
    ProjectionMode,
    defect,
)
from shield import HorizonProjector
from tests.irl_dal.planner.scenes import HORIZON, LIMITS

Array = NDArray[np.float64]

PREVIOUS = np.array([0.05, 6.0])

STEPS = 4

WHERE = {
    # mode: (clean estimates projected, iterates projected) over four reverse steps
    "none": ([], []),
    "final": ([3], []),
    "x0": ([0, 1, 2, 3], []),
    "xt": ([3], [0, 1, 2]),
    "adaptive": ([0, 2, 3], []),
}


def projection(mode: str) -> PlanProjection:
    """One sampling's projection."""
    return PlanProjection(mode, HorizonProjector(LIMITS, HORIZON), PREVIOUS)  # type: ignore[arg-type]


def wild(batch: int = 1) -> Array:
    """Normalised plans that break every bound."""
    return np.random.default_rng(0).uniform(-1.5, 1.5, (batch, HORIZON, 2))


def calm(batch: int = 1) -> Array:
    """Normalised plans that hold the last command."""
    return np.tile(LIMITS.to_action(PREVIOUS), (batch, HORIZON, 1))


def admissible(plan: Array) -> bool:
    """Whether a horizon (H, 2) [rad, m/s] breaks nothing, from the last command on."""
    steps = zip(plan, [PREVIOUS, *plan[:-1]], strict=True)
    return not any(LIMITS.violated(now, before) for now, before in steps)


@pytest.mark.parametrize("mode", PROJECTION_MODES)
def test_each_mode_projects_where_it_says(mode: ProjectionMode) -> None:
    """Estimates and iterates are changed exactly on the steps of the module's table."""
    stage = projection(mode)
    cleans, iterates = [], []
    for index in range(STEPS):
        estimate = calm() if mode == "adaptive" and index == 1 else wild()
        last = index + 1 == STEPS
        refined = stage.finish(estimate).actions if last else stage.clean(estimate, index)
        if not np.array_equal(refined, estimate):
            cleans.append(index)
        if not last and not np.array_equal(stage.noisy(wild(), index), wild()):
            iterates.append(index)
    expected_cleans, expected_iterates = WHERE[mode]
    assert cleans == expected_cleans
    assert iterates == expected_iterates


@pytest.mark.parametrize("batch", [1, 3, 10])
@pytest.mark.parametrize("mode", PROJECTION_MODES)
def test_the_last_estimate_is_admissible_unless_mode_none(mode: str, batch: int) -> None:
    """Every mode but `none` ends in horizons that break nothing; `none` leaves them as they are."""
    last = projection(mode).finish(wild(batch))
    np.testing.assert_allclose(last.nominal, LIMITS.to_command(wild(batch)))
    assert not admissible(last.nominal[0])
    np.testing.assert_allclose(last.actions, LIMITS.to_action(last.commands), atol=1e-12)
    if mode == "none":
        assert last.projections == ()
        np.testing.assert_array_equal(last.commands, last.nominal)
    else:
        assert len(last.projections) == batch
        assert all(map(admissible, last.commands))


def test_defect_is_zero_exactly_on_admissible_horizons() -> None:
    """A projected horizon has no defect beyond rounding; a wild one has."""
    projector = HorizonProjector(LIMITS, HORIZON)
    plans = LIMITS.to_command(wild(20))
    inside = np.stack([projector.project(plan, PREVIOUS).actions for plan in plans])
    assert float(defect(inside, PREVIOUS, LIMITS).max()) < 1e-9
    assert float(defect(plans, PREVIOUS, LIMITS).min()) > 0.0


def test_defect_is_a_share_of_the_bound() -> None:
    """One and a half times a bound is a defect of a half, for rates and the lateral bound."""
    plan = np.tile(PREVIOUS, (1, HORIZON, 1))
    plan[0, :, 0] += 1.5 * LIMITS.steering_step
    assert float(defect(plan, PREVIOUS, LIMITS)[0]) == pytest.approx(0.5)
    slow = np.tile([0.0, 5.0], (1, HORIZON, 1))
    slow[0, 0, 1] -= 3.0 * LIMITS.deceleration_step
    slow[0, 1:, 1] = slow[0, 0, 1]
    assert float(defect(slow, np.array([0.0, 5.0]), LIMITS)[0]) == pytest.approx(2.0)
    fast = np.array([np.arctan(6.0 * LIMITS.wheelbase / 100.0), 10.0])
    assert float(defect(np.tile(fast, (1, HORIZON, 1)), fast, LIMITS)[0]) == pytest.approx(0.5)


def test_one_by_one_or_batched_is_the_same_projection() -> None:
    """The candidates below and above the switch get the same horizons, to the solver's digits."""
    few, many = projection("x0"), projection("x0")
    plans = wild(10)
    apart = np.concatenate([few.clean(plans[i : i + 1], 0) for i in range(len(plans))])
    gap = np.abs(apart - many.clean(plans, 0))
    assert (
        float(np.median(gap.max(axis=(1, 2)))) < 1e-6
    )  # where the lateral bound binds, local optima
