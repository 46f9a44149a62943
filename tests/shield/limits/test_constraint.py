"""Constraints return rows that say what the bounds say, and their stack is that of all rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from shield import UNBOUNDED, InvalidLimits, InvalidProblem, Rows
from shield.limits.box import BoxLimit
from shield.limits.constraint import RowStack
from shield.limits.lateral import LateralLimit
from shield.limits.rate import RateLimit
from tests.shield import tolerances
from tests.shield.oracles import quadratic_program
from tests.shield.strategies import CITY, Array

UNIT = np.array([0.06, 0.6])


def stack(horizon: int) -> RowStack:
    """Return the stack of G1 and G2."""
    return RowStack([BoxLimit(CITY, horizon), RateLimit(CITY, horizon)], horizon, UNIT)


def test_box_and_rate_rows_describe_the_same_set_as_an_independent_writing(
    rng: np.random.Generator,
) -> None:
    """Random horizons satisfy the rows exactly when they satisfy the other formulation."""
    previous, rows = np.array([0.05, 5.0]), stack(4)
    agreements = []
    for _ in range(500):
        actions = previous + np.cumsum(rng.uniform(-1.0, 1.0, (4, 2)) * [0.07, 0.5], axis=0)
        rows.evaluate(actions, previous)
        inside = bool((rows.excess(actions.ravel() / np.tile(UNIT, 4)) == 0.0).all())
        problem = quadratic_program(CITY, actions, previous)
        point = actions.ravel()
        other = bool(
            (problem.G @ point <= problem.h).all()
            and (problem.lb <= point).all()
            and (point <= problem.ub).all()
        )
        assert inside == other
        agreements.append(inside)
    assert 0 < sum(agreements) < 500


def test_the_lateral_row_is_tangent_and_on_the_side_of_the_curve() -> None:
    """At a point on the boundary the row is active; one step outwards breaks it."""
    speed = 10.0
    steering = np.arctan(4.0 * 2.7 / speed**2)
    for side in (-1.0, 1.0):
        actions = np.array([[side * steering, speed]])
        rows = LateralLimit(CITY, 1).rows(actions, np.zeros(2))
        value = rows.matrix @ actions.ravel()
        assert (rows.upper if side > 0 else rows.lower) == pytest.approx(value, abs=1e-12)
        outside = rows.matrix @ (actions.ravel() + [side * 0.01, 0.1])
        assert (outside > rows.upper) if side > 0 else (outside < rows.lower)


def test_lateral_rows_are_never_looser_than_the_bound(rng: np.random.Generator) -> None:
    """What keeps the rows at any horizon and steers to the same side keeps the bound."""
    limit, kept = LateralLimit(CITY, 1), 0
    for _ in range(2000):
        at, actions = rng.uniform([0.0, 0.0], [0.5, 12.0], (2, 1, 2))
        rows = limit.rows(at, np.zeros(2))
        if (rows.matrix @ actions.ravel() <= rows.upper).all():
            kept += 1
            assert CITY.lateral_acceleration(actions).max() <= 4.0 * (1.0 + 1e-12)
        own = limit.rows(actions, np.zeros(2))
        keeps_rows = bool((own.matrix @ actions.ravel() <= own.upper * (1.0 + 1e-12)).all())
        assert keeps_rows == (CITY.lateral_acceleration(actions).max() <= 4.0 * (1.0 + 1e-12))
    assert 0 < kept < 2000


def test_lateral_rows_have_the_gradient_of_finite_differences(rng: np.random.Generator) -> None:
    """Of v² tan δ, the bound times the wheelbase, at points of the curve."""
    speed = rng.uniform(6.0, 12.0, 8)
    actions = np.column_stack([np.arctan(10.8 / speed**2), speed])
    matrix = LateralLimit(CITY, 8).rows(actions, np.zeros(2)).matrix.toarray()
    for channel, step in enumerate(1e-6 * np.eye(2)):
        ahead, behind = (CITY.lateral_acceleration(actions + sign * step) for sign in (1, -1))
        slope = (ahead - behind) / 2e-6
        got = matrix[np.arange(8), 2 * np.arange(8) + channel]
        assert got == pytest.approx(slope, rel=tolerances.GRADIENT)


class Random:
    """A constraint whose rows are dense, sparse or of another pattern from call to call."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.last: Rows | None = None

    def rows(self, actions: Array, previous: Array) -> Rows:
        """Return any rows."""
        count = int(self._rng.integers(1, 4))
        matrix = self._rng.normal(size=(count, 2 * len(actions)))
        if self._rng.random() < 0.7:
            matrix = sparse.csr_matrix(matrix * (self._rng.random(matrix.shape) < 0.5))
        self.last = Rows(matrix, np.full(count, -UNBOUNDED), self._rng.normal(size=count))
        return self.last


def test_the_stack_is_that_of_all_rows_whatever_their_pattern(rng: np.random.Generator) -> None:
    """Against dense arrays put together here, from call to call."""
    own = Random(rng)
    rows = RowStack([BoxLimit(CITY, 3), own, RateLimit(CITY, 3)], 3, UNIT)
    for _ in range(50):
        previous = rng.uniform(0.0, 1.0, 2)
        rows.evaluate(np.zeros((3, 2)), previous)
        parts = BoxLimit(CITY, 3).rows(np.zeros((3, 2)), previous), own.last
        parts = (*parts, RateLimit(CITY, 3).rows(np.zeros((3, 2)), previous))
        dense = np.vstack([
            part.matrix.toarray() if sparse.issparse(part.matrix) else part.matrix
            for part in parts
        ])  # fmt: skip
        z, y = rng.normal(size=6), rng.normal(size=len(dense))
        assert rows.times(z) * rows.norm == pytest.approx(dense @ (z * np.tile(UNIT, 3)))
        expected = (dense * np.tile(UNIT, 3)).T @ (y / rows.norm)
        assert rows.transposed_times(y) == pytest.approx(expected)
        assert rows.upper * rows.norm == pytest.approx(np.concatenate([p.upper for p in parts]))
        assert len(rows.spans) == 3


def test_the_duality_gap_bounds_the_error_for_any_multipliers(rng: np.random.Generator) -> None:
    """One variable by hand: nearest to 3 below 1 is 1, half a distance of 2 squared."""
    rows = stack(1)
    rows.evaluate(np.zeros((1, 2)), np.array([0.0, 6.0]))
    z, goal, weights = np.array([1.0, 10.0]), np.array([3.0, 10.0]), np.ones(2)
    y = np.zeros(4)
    assert rows.duality_gap(z, goal, weights, y) == pytest.approx(2.0)
    y[2] = 2.0 * rows.norm[2] / UNIT[0]  # the pull of 2 at the rate's upper bound
    assert rows.duality_gap(z, goal, weights, y) == pytest.approx(0.0, abs=1e-12)
    for _ in range(100):
        worse = z - np.abs(rng.normal(size=2)) * [1.0, 0.0]
        gap = rows.duality_gap(worse, goal, weights, rng.normal(size=4))
        assert gap >= 0.5 * ((worse - goal) @ (worse - goal) - 4.0) - 1e-12


def test_design_mistakes_raise() -> None:
    """No lateral bound to linearise, nothing to stack, rows that fit no horizon."""

    class Wrong:
        def rows(self, actions: Array, previous: Array) -> Rows:
            return Rows(np.zeros((1, 3)), np.zeros(1), np.zeros(1))

    with pytest.raises(InvalidLimits, match="`max_lateral_acceleration`"):
        LateralLimit(replace(CITY, max_lateral_acceleration=None), 2)
    with pytest.raises(InvalidProblem, match="`constraints`"):
        RowStack([], 1, UNIT)
    with pytest.raises(InvalidProblem, match=r"`rows` of Wrong .* Got \(\(1, 3\)"):
        RowStack([Wrong()], 1, UNIT)
