"""How fast projections are, next to bare solvers on the same problems in the same run."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import casadi
import numpy as np
import osqp
from scipy import sparse

from shield.bench.problems import bending_problems, random_problems
from shield.errors import Array
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.box import BoxLimit
from shield.limits.rate import RateLimit
from shield.projection.projector import HorizonProjector

__all__ = ["single_against_bare"]

Run = Callable[[int], Any]

# Tolerances of bare OSQP [-]. The first is the one to compare at: its answers then break a bound by
# about 1e-6 of a step, the default `tolerance` of the projector. The others show what less costs,
# the last being OSQP's own default.
_COMPARED, _LOOSER, _DEFAULT = 1e-8, 1e-6, 1e-3
_ROUNDS = 5  # [-] how often all problems are timed, after one round that warms up
_TURN = 20  # [-] problems of a turn
_TIME_LIMIT = 10.0  # [s] of all: a busy machine must not cut an answer short


class _Programs(NamedTuple):
    """Quadratic programs, in steps of the actuators: nearest to a goal within the same rows."""

    matrix: sparse.csc_matrix
    goals: Array
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
    programs = _programs(linear, nominals, previous)
    bare = {
        f"bare_osqp_{tolerance:.0e}": _bare_osqp(programs, tolerance)
        for tolerance in (_COMPARED, _LOOSER, _DEFAULT)
    }
    others = {**bare, "casadi_conic_osqp": _casadi_osqp(programs)}
    runs = {"project": _projections(projector, nominals, previous), **others}
    times = _take_turns(runs, count)
    median = {name: float(np.median(best)) for name, best in times.items()}
    result = {f"ratio_to_{name}": median["project"] / median[name] for name in others}
    for name, run in bare.items():
        answers = np.array([run(index).x for index in range(count)]) @ programs.matrix.T
        excess = np.maximum(answers - programs.upper, programs.lower - answers)
        result[f"{name}_worst_violation"] = float(excess.max())
    result["project_violations"] = _violations(projector, nominals, previous)
    for name, draw in (("random", random_problems), ("bending", bending_problems)):
        nominals, previous = draw(limits, horizon, count, rng)
        projector = HorizonProjector(limits, horizon, deadline=_TIME_LIMIT)
        run = _projections(projector, nominals, previous)
        times |= _take_turns({f"project_lateral_{name}": run}, count)
        violations = _violations(projector, nominals, previous)
        result[f"project_lateral_{name}_violations"] = violations
    for name, best in times.items():
        for percent in (50, 99):
            result[f"{name}_p{percent}_ms"] = 1e3 * float(np.percentile(best, percent))
    return result


def _projections(projector: HorizonProjector, nominals: Array, previous: Array) -> Run:
    return lambda index: projector.project(nominals[index], previous[index])


def _take_turns(runs: Mapping[str, Run], problems: int) -> dict[str, Array]:
    """Return the least time of each problem on the processor [s]: busy neighbours do not count.

    In a turn of a millisecond or so an alternative runs a few problems one after the other, as it
    would in a loop: its own code and data are in the caches, and a warm start comes from another
    problem.
    """
    times = {name: np.empty((_ROUNDS + 1, problems)) for name in runs}
    for turn in range(_ROUNDS + 1):
        for start in range(0, problems, _TURN):
            for name, run in runs.items():
                for problem in range(start, min(start + _TURN, problems)):
                    begin = time.thread_time()
                    run(problem)
                    times[name][turn, problem] = time.thread_time() - begin
    return {name: rows[1:].min(axis=0) for name, rows in times.items()}


def _violations(projector: HorizonProjector, nominals: Array, previous: Array) -> int:
    broken = 0
    for nominal, last in zip(nominals, previous, strict=True):
        actions = projector.project(nominal, last).actions
        broken += sum(map(projector.limits.violated, actions, [last, *actions[:-1]]))
    return broken


def _programs(limits: ActuatorLimits, nominals: Array, previous: Array) -> _Programs:
    """Write down the quadratic programs of G1 and G2 from the rows of the constraints."""
    horizon = nominals.shape[1]
    box, rate = BoxLimit(limits, horizon), RateLimit(limits, horizon)
    rows = [(box.rows(*pair), rate.rows(*pair)) for pair in zip(nominals, previous, strict=True)]
    scale = np.tile(limits.step, horizon)
    matrix = sparse.vstack([part.matrix for part in rows[0]]) @ sparse.diags(scale)
    return _Programs(
        sparse.csc_matrix(matrix),
        nominals.reshape(len(nominals), -1) / scale,
        np.array([np.concatenate([part.lower for part in parts]) for parts in rows]),
        np.array([np.concatenate([part.upper for part in parts]) for parts in rows]),
    )


def _bare_osqp(programs: _Programs, tolerance: float) -> Run:
    """Return OSQP's own update and solve, with a warm start."""
    matrix, goals, lower, upper = programs
    workspace = osqp.OSQP()
    workspace.setup(
        sparse.identity(matrix.shape[1], format="csc"),
        -goals[0],
        matrix,
        lower[0],
        upper[0],
        eps_abs=tolerance,
        eps_rel=tolerance,
        time_limit=_TIME_LIMIT,
        adaptive_rho_interval=50,
        check_termination=10,
        verbose=False,
    )

    def run(index: int) -> Any:
        workspace.update(q=-goals[index], l=lower[index], u=upper[index])
        return workspace.solve(raise_error=False)

    return run


def _casadi_osqp(programs: _Programs) -> Run:
    """Return CasADi's `conic("osqp")` at the tolerance to compare at, for each problem."""
    _, goals, lower, upper = programs
    hessian, matrix = casadi.DM.eye(goals.shape[1]), casadi.DM(programs.matrix)
    options = {"eps_abs": _COMPARED, "eps_rel": _COMPARED, "verbose": False}
    solver = casadi.conic(
        "solver",
        "osqp",
        {"h": hessian.sparsity(), "a": matrix.sparsity()},
        {"osqp": options, "error_on_fail": False},
    )
    return lambda index: solver(
        h=hessian, g=-goals[index], a=matrix, lba=lower[index], uba=upper[index]
    )
