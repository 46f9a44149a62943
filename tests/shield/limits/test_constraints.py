"""Constraints return rows that say what the bounds say."""

from dataclasses import replace

import numpy as np
import pytest

from shield import InvalidLimits, InvalidProblem
from shield.limits.constraints import UNBOUNDED, BoxLimit, LateralLimit, RateLimit, stack_rows
from tests.shield.oracles import quadratic_program
from tests.shield.strategies import CITY


def test_box_and_rate_rows_describe_the_same_set_as_an_independent_writing(
    rng: np.random.Generator,
) -> None:
    """Random horizons satisfy the rows exactly when they satisfy the other formulation."""
    previous = np.array([0.05, 5.0])
    agreements = []
    for _ in range(500):
        actions = previous + np.cumsum(rng.uniform(-1.0, 1.0, (4, 2)) * [0.07, 0.5], axis=0)
        rows = stack_rows([BoxLimit(CITY), RateLimit(CITY)], actions, previous)
        value = rows.matrix @ actions.ravel()
        inside = bool(((rows.lower <= value) & (value <= rows.upper)).all())
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


def test_a_standing_vehicle_has_no_lateral_row() -> None:
    """The gradient vanishes, so the row must not bind."""
    rows = LateralLimit(CITY, 2).rows(np.zeros((2, 2)), np.zeros(2))
    assert (rows.upper >= UNBOUNDED).all()
    assert (rows.lower <= -UNBOUNDED).all()


def test_design_mistakes_raise() -> None:
    """No lateral bound to linearise, and nothing to stack."""
    with pytest.raises(InvalidLimits, match="`max_lateral_acceleration`"):
        LateralLimit(replace(CITY, max_lateral_acceleration=None), 2)
    with pytest.raises(InvalidProblem, match="`constraints`"):
        stack_rows([], np.zeros((1, 2)), np.zeros(2))
