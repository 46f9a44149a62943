"""How fast projections are, next to bare solvers on the same problems in the same run."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import casadi
import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

from shield.bench.problems import bending_problems, random_problems
from shield.bench.timing import Timing, take_turns
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.box import BoxLimit
from shield.limits.constraint import Constraint, RowStack
from shield.limits.rate import RateLimit
from shield.projection.projector import HorizonProjector

__all__ = ["single_against_bare"]

Array = NDArray[np.float64]

# Tolerances of bare OSQP [-]. The first is the one to compare at: its answers then break a bound by
# about 1e-6 of a step, the default `tolerance` of the projector. The others show what less costs,
# the last being OSQP's own default.
_COMPARED, _LOOSER, _DEFAULT = 1e-8, 1e-6, 1e-3
_ROUNDS = 5
# Time limit [s] of all: a busy machine must not cut an answer short.
_TIME_LIMIT = 10.0


class _Problem(NamedTuple):
    """A quadratic program, in steps of the actuators: nearest to `goal` within the rows."""

    goal: Array
    matrix: sparse.csc_matrix
    lower: Array
    upper: Array


def single_against_bare(
    limits: ActuatorLimits, horizon: int, count: int, rng: np.random.Generator
) -> dict[str, float]:
    """Time `project` against bare OSQP and CasADi's OSQP on the same quadratic programs.

    The programs are those of G1 and G2. Two more sets, random and one in which the lateral bound
    binds, are timed with all limits.

    Returns:
        Ratios of the medians, by how much the answers of bare OSQP break a bound in steps, how many
        answers of `project` break any, and milliseconds: p50 and p99 over the problems, of the best
        of several rounds.
    """
    linear = replace(limits, max_lateral_acceleration=None)
    projector = HorizonProjector(linear, horizon, deadline=_TIME_LIMIT)
    nominals, previous = random_problems(linear, horizon, count, rng)
    problems = _programs(linear, nominals, previous)
    bare = {
        f"bare_osqp_{tolerance:.0e}": _bare_osqp(problems, tolerance)
        for tolerance in (_COMPARED, _LOOSER, _DEFAULT)
    }
    alternatives: dict[str, Callable[[int], Any]] = {
        "project": lambda index: projector.project(nominals[index], previous[index]),
        **bare,
        "casadi_conic_osqp": _casadi_osqp(problems),
    }
    timings = dict(
        zip(alternatives, take_turns(list(alternatives.values()), count, _ROUNDS), strict=True)
    )
    result: dict[str, float] = {}
    for name in (*bare, "casadi_conic_osqp"):
        result[f"ratio_to_{name}"] = timings["project"].quantile(0.5) / timings[name].quantile(0.5)
    for name, run in bare.items():
        result[f"{name}_worst_violation"] = max(
            _violation(run(index).x, problem) for index, problem in enumerate(problems)
        )
    result["project_violations"] = _violations(projector, nominals, previous)
    for name, timing in timings.items():
        result |= _milliseconds(name, timing)
    for name, draw in (("random", random_problems), ("bending", bending_problems)):
        result |= _all_limits(name, limits, draw(limits, horizon, count, rng))
    return result


def _all_limits(
    name: str, limits: ActuatorLimits, problems: tuple[Array, Array]
) -> dict[str, float]:
    """Time `project` with the lateral bound."""
    nominals, previous = problems
    projector = HorizonProjector(limits, nominals.shape[1], deadline=_TIME_LIMIT)
    (timing,) = take_turns(
        [lambda index: projector.project(nominals[index], previous[index])], len(nominals), _ROUNDS
    )
    return {
        f"project_lateral_{name}_violations": _violations(projector, nominals, previous),
        **_milliseconds(f"project_lateral_{name}", timing),
    }


def _violations(projector: HorizonProjector, nominals: Array, previous: Array) -> int:
    """Count the commands that break a limit by any amount."""
    broken = 0
    for nominal, last in zip(nominals, previous, strict=True):
        actions = projector.project(nominal, last).actions
        before = [last, *actions[:-1]]
        broken += sum(map(projector.limits.violated, actions, before))
    return broken


def _programs(limits: ActuatorLimits, nominals: Array, previous: Array) -> list[_Problem]:
    """Write down the quadratic programs of G1 and G2 from the rows of the constraints."""
    horizon = nominals.shape[1]
    constraints: list[Constraint] = [BoxLimit(limits, horizon), RateLimit(limits, horizon)]
    rows = RowStack(constraints, horizon, limits.step)
    shape = (len(rows.norm), 2 * horizon)
    matrix = sparse.csc_matrix((rows.value * rows.norm[rows.row], (rows.row, rows.column)), shape)
    problems = []
    for nominal, last in zip(nominals, previous, strict=True):
        rows.evaluate(nominal, last)
        goal = (nominal / limits.step).ravel()
        problems.append(_Problem(goal, matrix, rows.lower * rows.norm, rows.upper * rows.norm))
    return problems


def _violation(z: Array, problem: _Problem) -> float:
    """Return by how much a horizon breaks its worst row [steps]."""
    value = problem.matrix @ z
    return float(np.maximum(value - problem.upper, problem.lower - value).max())


def _milliseconds(name: str, timing: Timing) -> dict[str, float]:
    return {
        f"{name}_p50_ms": 1e3 * timing.quantile(0.5),
        f"{name}_p99_ms": 1e3 * timing.quantile(0.99),
    }


def _bare_osqp(problems: list[_Problem], tolerance: float) -> Callable[[int], Any]:
    """Return OSQP's own update and solve, with a warm start, for each problem."""
    first = problems[0]
    workspace = osqp.OSQP()
    workspace.setup(
        sparse.identity(len(first.goal), format="csc"),
        -first.goal,
        first.matrix,
        first.lower,
        first.upper,
        eps_abs=tolerance,
        eps_rel=tolerance,
        time_limit=_TIME_LIMIT,
        adaptive_rho_interval=50,
        check_termination=10,
        verbose=False,
    )

    def run(index: int) -> Any:
        problem = problems[index]
        workspace.update(q=-problem.goal, l=problem.lower, u=problem.upper)
        return workspace.solve(raise_error=False)

    return run


def _casadi_osqp(problems: list[_Problem]) -> Callable[[int], object]:
    """Return CasADi's `conic("osqp")` at the tolerance to compare at, for each problem."""
    hessian = casadi.DM.eye(len(problems[0].goal))
    matrix = casadi.DM(problems[0].matrix)
    options = {"eps_abs": _COMPARED, "eps_rel": _COMPARED, "verbose": False}
    solver = casadi.conic(
        "solver",
        "osqp",
        {"h": hessian.sparsity(), "a": matrix.sparsity()},
        {"osqp": options, "error_on_fail": False},
    )

    def run(index: int) -> object:
        problem = problems[index]
        return solver(h=hessian, g=-problem.goal, a=matrix, lba=problem.lower, uba=problem.upper)

    return run
