"""Nothing nearer is admissible: other solvers and IPOPT cannot do better."""

import numpy as np
import pytest

from shield import ActuatorLimits, HorizonProjector, Status
from shield.bench.problems import bending_problems, random_problems
from tests.shield import tolerances
from tests.shield.oracles import best_objective, ipopt_objective
from tests.shield.strategies import CITY, LINEAR, Array, linear_problems, projector
from tests.shield.tiers import two_tiers


@two_tiers(problem=linear_problems())
def test_g1_and_g2_are_within_1e_6_of_the_best_of_the_independent_solvers(
    problem: tuple[ActuatorLimits, Array, Array],
) -> None:
    """The objective against the best of at least three solvers through qpsolvers."""
    limits, nominal, previous = problem
    target = projector(limits, len(nominal))
    got = target.project(nominal, previous)
    best = best_objective(limits, nominal, previous)
    excess = target.objective(got.actions, nominal) - best
    assert excess <= tolerances.OBJECTIVE * best + tolerances.OBJECTIVE_FLOOR


def _worse_than_ipopt(count: int, seed: int) -> tuple[int, int]:
    """Return how often IPOPT from the same start is better, and how often it answered."""
    rng = np.random.default_rng(seed)
    target = projector(CITY, 8)
    worse = answered = 0
    for draw in (random_problems, bending_problems):
        for nominal, previous in zip(*draw(CITY, 8, count, rng), strict=True):
            got = target.project(nominal, previous)
            best = ipopt_objective(CITY, nominal, previous, nominal)
            if got.status is Status.NOMINAL or best is None:
                continue
            answered += 1
            excess = target.objective(got.actions, nominal) - best
            worse += excess > tolerances.OBJECTIVE * best + tolerances.OBJECTIVE_FLOOR
    return worse, answered


def test_g3_is_no_worse_than_ipopt_in_99_percent_of_cases() -> None:
    """IPOPT on the nonconvex problem, started from the nominal horizon."""
    worse, answered = _worse_than_ipopt(75, seed=0)
    assert answered >= 140
    assert worse <= 0.01 * answered


@pytest.mark.slow
def test_g3_is_no_worse_than_ipopt_in_99_percent_of_cases_10k() -> None:
    """The same on 10,000 problems."""
    worse, answered = _worse_than_ipopt(5000, seed=1)
    assert answered >= 9000
    assert worse <= 0.01 * answered


@pytest.mark.parametrize("solver", ["daqp", "quadprog", "clarabel", "piqp", "proxqp"])
@pytest.mark.parametrize("limits", [CITY, LINEAR], ids=["lateral", "linear"])
def test_every_solver_by_name_gives_the_same_projection(
    solver: str, limits: ActuatorLimits, rng: np.random.Generator
) -> None:
    """The answer does not depend on who finds the active bounds."""
    pytest.importorskip("proxsuite" if solver == "proxqp" else solver)
    other, ours = HorizonProjector(limits, 8, solver=solver, deadline=2.0), projector(limits, 8)
    draw = bending_problems if limits is CITY else random_problems
    for nominal, previous in zip(*draw(limits, 8, 20, rng), strict=True):
        one, two = ours.project(nominal, previous), other.project(nominal, previous)
        first, second = ours.objective(one.actions, nominal), ours.objective(two.actions, nominal)
        assert first == pytest.approx(second, rel=1e-5, abs=tolerances.OBJECTIVE_FLOOR)
