"""Constraints of the caller's own: kept with them, broken without, and the result says so."""

import copy

import numpy as np
import pytest

from shield import UNBOUNDED, HorizonProjector, InvalidProblem, Rows, Status
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import CITY, Array

PATIENT = 5.0  # [s] a busy machine must not cut an answer short
PREVIOUS = np.array([0.0, 8.0])
NOMINAL = np.tile([0.05, 11.0], (8, 1))


class SpeedLimit:
    """v_t <= limit_t; the limit may be changed from call to call."""

    def __init__(self, limit: Array) -> None:
        self.limit = limit

    def rows(self, actions: Array, previous: Array) -> Rows:
        """Return one row per step."""
        matrix = np.eye(2 * len(actions))[1::2]
        return Rows(matrix, np.full(len(actions), -UNBOUNDED), self.limit)


class Circle:
    """(v_t / 9)² + (δ_t / 0.3)² <= 1, linearised: a bound that is not linear."""

    def rows(self, actions: Array, previous: Array) -> Rows:
        """Return the tangents at the actions."""
        size = 2 * len(actions)
        gradient = 2.0 * actions / np.array([0.3, 9.0]) ** 2
        matrix = np.zeros((len(actions), size))
        for step, (turn, change) in enumerate(gradient):
            matrix[step, 2 * step : 2 * step + 2] = turn, change
        value = ((actions / [0.3, 9.0]) ** 2).sum(axis=1)
        upper = 1.0 - value + (gradient * actions).sum(axis=1)
        return Rows(matrix, np.full(len(actions), -UNBOUNDED), upper)


def test_a_speed_limit_along_the_horizon_is_kept_with_it_and_broken_without() -> None:
    """As near as without it everywhere else, with all limits exact."""
    limit = np.array([9.0, 9.0, 9.0, 8.5, 8.0, 7.5, 7.0, 7.0])
    free = HorizonProjector(CITY, 8).project(NOMINAL, PREVIOUS)
    kept = HorizonProjector(CITY, 8, constraints=[SpeedLimit(limit)], deadline=PATIENT).project(
        NOMINAL, PREVIOUS
    )
    assert (free.actions[:, 1] > limit).any()
    assert free.violations == ()
    assert (kept.actions[:, 1] <= limit + 1e-6).all()
    assert kept.status is Status.PROJECTED
    assert kept.violations == pytest.approx((0.0,), abs=1e-6)
    assert broken_bounds(CITY, kept.actions, PREVIOUS) == []


def test_a_nominal_that_keeps_everything_passes_and_one_that_does_not_is_projected() -> None:
    """The caller's rows decide, too, whether a horizon is admissible."""
    target = HorizonProjector(CITY, 8, constraints=[SpeedLimit(np.full(8, 8.1))], deadline=PATIENT)
    calm = np.tile([0.0, 8.0], (8, 1))
    got = target.project(calm, PREVIOUS)
    assert got.status is Status.NOMINAL
    assert got.actions.tobytes() == calm.tobytes()
    assert target.project(calm + [0.0, 0.2], PREVIOUS).status is Status.PROJECTED


def test_what_cannot_be_kept_with_the_limits_is_broken_as_little_as_possible() -> None:
    """A limit that falls faster than the brakes: full braking, and the figure says by how much."""
    target = HorizonProjector(CITY, 8, constraints=[SpeedLimit(np.full(8, 5.0))], deadline=PATIENT)
    got = target.project(NOMINAL, PREVIOUS)
    assert broken_bounds(CITY, got.actions, PREVIOUS) == []
    assert got.status is Status.REPAIRED
    assert "cannot be kept" in got.reason
    assert got.actions[:, 1] == pytest.approx([7.4, 6.8, 6.2, 5.6, 5.0, 5.0, 5.0, 5.0], abs=0.01)
    assert got.violations == pytest.approx((2.4,), abs=2e-3)
    assert got.max_violation == 0.0
    # The next problem, which can be kept, is none the worse for it.
    again = target.project(NOMINAL, [0.0, 5.0])
    assert again.status is Status.PROJECTED
    assert again.violations == pytest.approx((0.0,), abs=1e-6)


def test_a_constraint_that_is_not_linear_is_kept() -> None:
    """A circle in the plane of commands, and the answer is the nearest on it."""
    target = HorizonProjector(CITY, 1, constraints=[Circle()], deadline=PATIENT)
    got = target.project([[0.04, 8.999]], [0.04, 8.95])
    assert got.status is Status.PROJECTED
    assert ((got.actions / [0.3, 9.0]) ** 2).sum() == pytest.approx(1.0, abs=1e-5)
    free = HorizonProjector(CITY, 1).project([[0.04, 8.999]], [0.04, 8.95])
    assert ((free.actions / [0.3, 9.0]) ** 2).sum() > 1.001


def test_several_constraints_each_have_their_figure() -> None:
    """In the order given; limits of the caller's may change between calls."""
    first, second = SpeedLimit(np.full(8, 9.0)), SpeedLimit(np.full(8, 4.0))
    target = HorizonProjector(CITY, 8, constraints=[first, second], deadline=PATIENT)
    got = target.project(NOMINAL, PREVIOUS)
    assert len(got.violations) == 2
    assert got.violations[0] == pytest.approx(0.0, abs=1e-9)
    assert got.violations[1] == pytest.approx(3.4, abs=2e-3)
    second.limit = np.full(8, 9.5)
    got = target.project(NOMINAL, PREVIOUS)
    assert got.status is Status.PROJECTED
    assert got.actions[-1, 1] == pytest.approx(9.0, abs=1e-5)


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
@pytest.mark.parametrize("horizon", [1, 8])
def test_rows_that_are_no_numbers_cost_the_optimum_and_not_the_limits(
    horizon: int, bad: float
) -> None:
    """Values are answered, never raised."""
    limit = SpeedLimit(np.full(horizon, bad))
    target = HorizonProjector(CITY, horizon, constraints=[limit], deadline=PATIENT)
    got = target.project(NOMINAL[:horizon], PREVIOUS)
    assert broken_bounds(CITY, got.actions, PREVIOUS) == []
    assert got.status is Status.REPAIRED
    assert not got.violations[0] <= 1e-6


def test_a_programming_error_in_a_constraint_surfaces() -> None:
    """Wrong shapes at once, exceptions as they are."""

    class Raising(SpeedLimit):
        def rows(self, actions: Array, previous: Array) -> Rows:
            if previous[1] > 0.0:
                raise KeyError("speed")
            return super().rows(actions, previous)

    target = HorizonProjector(CITY, 8, constraints=[Raising(np.full(8, 5.0))], deadline=PATIENT)
    with pytest.raises(KeyError, match="speed"):
        target.project(NOMINAL, PREVIOUS)
    with pytest.raises(InvalidProblem, match="`rows` of SpeedLimit"):
        HorizonProjector(CITY, 8, constraints=[SpeedLimit(np.full(3, 5.0))], deadline=PATIENT)


def test_a_copy_is_independent_and_answers_the_same() -> None:
    """`copy.deepcopy` builds anew, constraints included."""
    limit = SpeedLimit(np.full(8, 9.0))
    target = HorizonProjector(CITY, 8, constraints=[limit], deadline=PATIENT)
    other = copy.deepcopy(target)
    limit.limit = np.full(8, 8.2)
    assert target.project(NOMINAL, PREVIOUS).actions[:, 1].max() == pytest.approx(8.2, abs=1e-5)
    assert other.project(NOMINAL, PREVIOUS).actions[:, 1].max() == pytest.approx(9.0, abs=1e-5)
