"""G1 and G2 against an exact dynamic program that needs no solver."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import ActuatorLimits
from tests.shield import tolerances
from tests.shield.chain import ChainBounds, solve_chain
from tests.shield.oracles import best_objective, broken_bounds, objective
from tests.shield.strategies import VEHICLES, Array, commands, horizons, projector
from tests.shield.tiers import two_tiers

Problem = tuple[ActuatorLimits, Array, Array]


def nearest(limits: ActuatorLimits, nominal: Array, previous: Array) -> Array:
    """Return the nearest horizon within G1 and G2, channel by channel."""
    columns = []
    for channel in range(2):
        bounds = ChainBounds(
            float(limits.low[channel]),
            float(limits.high[channel]),
            float(limits.max_increase[channel]),
            float(limits.max_decrease[channel]),
        )
        targets = nominal[:, channel].tolist()
        columns.append(solve_chain(targets, bounds, float(previous[channel])))
    return np.column_stack(columns)


@st.composite
def vehicle_problems(draw: st.DrawFn) -> Problem:
    """Draw a problem without lateral bound of one of the fixed vehicles, up to 20 steps long."""
    limits = replace(draw(st.sampled_from(VEHICLES)), max_lateral_acceleration=None)
    previous = draw(commands(limits))
    return limits, draw(horizons(limits, draw(st.sampled_from([1, 8, 20])), previous)), previous


@two_tiers(problem=vehicle_problems())
def test_the_projection_is_the_exact_optimum(problem: Problem) -> None:
    """The same objective as the dynamic program to 1e-6, and the same commands to 1e-3 steps."""
    limits, nominal, previous = problem
    exact = nearest(limits, nominal, previous)
    got = projector(limits, len(nominal)).project(nominal, previous)
    least = objective(limits, exact, nominal)
    excess = objective(limits, got.actions, nominal) - least
    assert excess <= tolerances.OBJECTIVE * least + tolerances.OBJECTIVE_FLOOR
    distance = np.abs((got.actions - exact) / limits.step).max()
    assert distance <= 1e-3 * (1.0 + np.sqrt(least))


def test_the_dynamic_program_is_as_good_as_the_best_of_other_solvers(
    rng: np.random.Generator,
) -> None:
    """The oracle has an oracle."""
    limits = replace(VEHICLES[0], max_lateral_acceleration=None)
    for _ in range(30):
        previous = rng.uniform(limits.low, limits.high)
        nominal = rng.uniform(1.5 * limits.low - 1.0, 1.5 * limits.high, (8, 2))
        exact = nearest(limits, nominal, previous)
        best = best_objective(limits, nominal, previous)
        assert objective(limits, exact, nominal) == pytest.approx(best, rel=1e-6, abs=1e-9)
        close = [name for name in broken_bounds(limits, exact, previous) if "box" in name]
        assert close == []
