"""How fast projections are, next to bare solvers on the same problems in the same run."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
import osqp
import qpsolvers
from numpy.typing import NDArray
from scipy import sparse

from shield.bench.problems import bending_problems, random_problems
from shield.bench.timing import Timing, take_turns
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraints import BoxLimit, RateLimit, Rows, stack_rows
from shield.projection.projector import HorizonProjector
from shield.projection.solvers import OsqpSolver

__all__ = ["batch_against_loop", "growth", "single_against_bare"]

Array = NDArray[np.float64]

# Tolerances of bare OSQP. The first is the one to compare at: its answers then break a bound by
# about 1e-6 of a step, the default `tolerance` of the projector. The others show what less costs,
# the last being OSQP's own default.
_COMPARED, _LOOSER, _DEFAULT = 1e-8, 1e-6, 1e-3
_ROUNDS = 5
# Time limit of bare OSQP [s]: a busy machine must not cut an answer short.
_PATIENCE = 10.0


def single_against_bare(
    limits: ActuatorLimits, horizon: int, count: int, rng: np.random.Generator
) -> dict[str, float]:
    """Time `project` against bare OSQP and CasADi's OSQP on the same quadratic programs.

    The programs are those of G1 and G2, with OSQP's settings the projector's own. Two more sets,
    random and one in which the lateral bound binds, are timed with all limits.

    Returns:
        Ratios of the medians, by how much the answers of bare OSQP break a bound in units of a
        step, and milliseconds: p50 and p99 over the problems, of the best of several rounds and of
        all of them.
    """
    linear = replace(limits, max_lateral_acceleration=None)
    projector = HorizonProjector(linear, horizon)
    nominals, previous = map(list, random_problems(linear, horizon, count, rng))
    rows = [
        stack_rows([BoxLimit(linear), RateLimit(linear)], one, last)
        for one, last in zip(nominals, previous, strict=True)
    ]
    bare = {
        f"bare_osqp_{tolerance:.0e}": _bare_osqp(nominals, rows, tolerance)
        for tolerance in (_COMPARED, _LOOSER, _DEFAULT)
    }
    alternatives: dict[str, Callable[[int], Any]] = {
        "project": lambda index: projector.project(nominals[index], previous[index]),
        **bare,
        "casadi_conic_osqp": _casadi_osqp(nominals, rows),
    }
    if "daqp" in qpsolvers.available_solvers:
        alternatives["bare_daqp"] = _bare_daqp(nominals, rows)
    timings = dict(
        zip(alternatives, take_turns(list(alternatives.values()), count, _ROUNDS), strict=True)
    )
    result: dict[str, float] = {}
    for name in (*bare, "casadi_conic_osqp"):
        ours, theirs = timings["project"], timings[name]
        result[f"ratio_to_{name}"] = ours.best_quantile(0.5) / theirs.best_quantile(0.5)
    unit = np.tile(np.minimum(linear.rise, linear.fall), horizon)
    for name, run in bare.items():
        result[f"{name}_worst_violation"] = max(
            _violation(run(index).x, one, np.tile(unit, 2)) for index, one in enumerate(rows)
        )
    for name, timing in timings.items():
        result |= _milliseconds(name, timing)
    return result | _all_limits(limits, horizon, count, rng)


def _all_limits(
    limits: ActuatorLimits, horizon: int, count: int, rng: np.random.Generator
) -> dict[str, float]:
    """Time `project` with the lateral bound, on random problems and where it binds."""
    projector = HorizonProjector(limits, horizon)
    result: dict[str, float] = {}
    for name, draw in (("random", random_problems), ("bending", bending_problems)):
        nominals, previous = draw(limits, horizon, count, rng)
        (timing,) = take_turns(
            [lambda i, n=nominals, p=previous: projector.project(n[i], p[i])],  # type: ignore[misc]
            count,
            _ROUNDS,
        )
        result |= _milliseconds(f"project_lateral_{name}", timing)
    return result


def _violation(z: Array, rows: Rows, unit: Array) -> float:
    """Return by how much a horizon breaks its worst row, in units of a step."""
    value = rows.matrix @ z
    return float(np.maximum((value - rows.upper) / unit, (rows.lower - value) / unit).max())


def batch_against_loop(
    limits: ActuatorLimits, horizon: int, count: int, rng: np.random.Generator
) -> dict[str, float]:
    """Time `project_batch` against a loop of `project` over the same horizons.

    Both run in one thread and are compared by its processor time, the best of seven turns, because
    a turn takes long enough for other processes to come in between.

    Returns:
        Milliseconds per horizon and ratios, for G1 and G2 alone, for the full limits on random
        problems, and on problems in which the lateral bound binds.
    """
    result: dict[str, float] = {}
    linear = replace(limits, max_lateral_acceleration=None)
    cases = {
        "linear": (linear, random_problems),
        "lateral": (limits, random_problems),
        "bending": (limits, bending_problems),
    }
    for name, (bounds, draw) in cases.items():
        projector = HorizonProjector(bounds, horizon)
        nominals, previous = draw(bounds, horizon, count, rng)
        loop, batch = take_turns(
            [
                lambda _, p=projector, n=nominals, v=previous: [  # type: ignore[misc]
                    p.project(one, last) for one, last in zip(n, v, strict=True)
                ],
                lambda _, p=projector, n=nominals, v=previous: p.project_batch(n, v),  # type: ignore[misc]
            ],
            1,
            rounds=7,
        )
        result[f"batch_{name}_speedup"] = loop.best_quantile(0.5) / batch.best_quantile(0.5)
        result[f"loop_{name}_ms_per_horizon"] = 1e3 * loop.best_quantile(0.5) / count
        result[f"batch_{name}_ms_per_horizon"] = 1e3 * batch.best_quantile(0.5) / count
    return result


def growth(
    limits: ActuatorLimits, horizons: list[int], batches: list[int], rng: np.random.Generator
) -> dict[str, dict[str, float]]:
    """Time one horizon against its length, and a batch against its size.

    Returns:
        Mean milliseconds of processor time per call: ``single`` by H, ``batch`` by B at H = 8.
    """
    single, batch = {}, {}
    for horizon in horizons:
        projector = HorizonProjector(limits, horizon)
        nominals, previous = random_problems(limits, horizon, 100, rng)
        (timing,) = take_turns(
            [lambda i, p=projector, n=nominals, v=previous: p.project(n[i], v[i])],  # type: ignore[misc]
            100,
            rounds=2,
        )
        single[str(horizon)] = 1e3 * float(timing.cpu.mean())
    projector = HorizonProjector(limits, 8)
    nominals, previous = random_problems(limits, 8, max(batches), rng)
    for size in batches:
        # Small batches differ much from each other, so several are cut out of the same problems.
        parts = min(len(nominals) // size, 40)
        (timing,) = take_turns(
            [
                lambda i, n=nominals, v=previous, b=size: projector.project_batch(  # type: ignore[misc]
                    n[i * b : (i + 1) * b], v[i * b : (i + 1) * b]
                )
            ],
            parts,
            rounds=5,
        )
        batch[str(size)] = 1e3 * float(timing.cpu.mean())
    return {"single": single, "batch": batch}


def _milliseconds(name: str, timing: Timing) -> dict[str, float]:
    return {
        f"{name}_p50_ms": 1e3 * timing.best_quantile(0.5),
        f"{name}_p99_ms": 1e3 * timing.best_quantile(0.99),
        f"{name}_cpu_p99_ms": 1e3 * timing.cpu_quantile(0.99),
        f"{name}_wall_p50_ms": 1e3 * timing.quantile(0.5),
        f"{name}_wall_p99_ms": 1e3 * timing.quantile(0.99),
        f"{name}_wall_max_ms": 1e3 * timing.quantile(1.0),
    }


def _bare_osqp(nominals: list[Array], rows: list[Rows], tolerance: float) -> Callable[[int], Any]:
    """Return OSQP's own update and solve, with a warm start, for each problem."""
    solver = OsqpSolver(
        np.ones(rows[0].matrix.shape[1]),
        sparse.csc_matrix(rows[0].matrix),
        tolerance,
        _PATIENCE,
    )
    workspace = osqp.OSQP()
    workspace.setup(
        sparse.identity(rows[0].matrix.shape[1], format="csc"),
        -nominals[0].ravel(),
        sparse.csc_matrix(rows[0].matrix),
        rows[0].lower,
        rows[0].upper,
        **solver.settings,
    )
    vectors = [-one.ravel() for one in nominals]

    def run(index: int) -> Any:
        workspace.update(q=vectors[index], l=rows[index].lower, u=rows[index].upper)
        return workspace.solve(raise_error=False)

    return run


def _casadi_osqp(nominals: list[Array], rows: list[Rows]) -> Callable[[int], object]:
    """Return CasADi's `conic("osqp")` at the tolerance to compare at, for each problem."""
    hessian = casadi.DM.eye(rows[0].matrix.shape[1])
    matrix = casadi.sparsify(casadi.DM(rows[0].matrix))
    options = {
        "eps_abs": _COMPARED,
        "eps_rel": _COMPARED,
        "verbose": False,
    }
    solver = casadi.conic(
        "solver",
        "osqp",
        {"h": hessian.sparsity(), "a": matrix.sparsity()},
        {"osqp": options, "error_on_fail": False},
    )

    def run(index: int) -> object:
        one = rows[index]
        return solver(h=hessian, g=-nominals[index].ravel(), a=matrix, lba=one.lower, uba=one.upper)

    return run


def _bare_daqp(nominals: list[Array], rows: list[Rows]) -> Callable[[int], object]:
    """Return DAQP through qpsolvers, from a cold start, for each problem."""
    size = rows[0].matrix.shape[1]
    inequality = np.vstack([rows[0].matrix[size:], -rows[0].matrix[size:]])
    problems = [
        qpsolvers.Problem(
            np.eye(size),
            -one.ravel(),
            inequality,
            np.concatenate([row.upper[size:], -row.lower[size:]]),
            lb=row.lower[:size],
            ub=row.upper[:size],
        )
        for one, row in zip(nominals, rows, strict=True)
    ]
    return lambda index: qpsolvers.solve_problem(problems[index], solver="daqp")
