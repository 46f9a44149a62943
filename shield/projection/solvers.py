r"""Quadratic program solvers behind one method.

The problem is :math:`\min_z \tfrac12 z^\top P z + q^\top z` subject to
:math:`l \le A z \le u`, with `P` diagonal and fixed, the pattern of `A` fixed, and everything else
changing from call to call. A solver that fails does not raise but answers ``(None, None, reason)``;
whatever else it raises is a mistake in the program and is not hidden.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
import osqp
import qpsolvers
from qpsolvers.exceptions import QPError
from scipy import sparse

from shield.errors import Array, InvalidProblem
from shield.limits.constraint import UNBOUNDED

__all__ = ["Answer", "OsqpSolver", "Program", "QPSolver", "QpsolversSolver", "make_solver"]

# Tolerances of OSQP before it polishes [-]. The coarse one identifies the active bounds of 99 % of
# the random horizons of `shield.bench`, for which polishing then solves to rounding errors. The
# fine one counts where polishing fails: 1e-6 left an objective 1.5e-6 too high.
COARSE, FINE = 1e-3, 1e-8
_MAX_ITERATIONS = 4000  # [-] several times what a horizon of eight steps takes

# Names of the arguments by which solvers of qpsolvers take a time limit; the others have none, and
# some work for seconds on a badly scaled problem, so their iterations are limited. ProxQP stops at
# 1e-5 by itself, too early to be verified.
_TIME_LIMITS = dict.fromkeys(("clarabel", "daqp", "highs"), "time_limit")
_TIME_LIMITS["scs"] = "time_limit_secs"
_OPTIONS: dict[str, dict[str, float]] = {
    "piqp": {"max_iter": 100},
    "proxqp": {"max_iter": 100, "eps_abs": 1e-9},
}


class Program(NamedTuple):
    """What changes from call to call."""

    q: Array  # shape (n,)
    lower: Array  # shape (m,)
    upper: Array  # shape (m,), nowhere below `lower`
    entries: Array | None = None  # of `A`, in the order of its CSC pattern; None: the last ones


class Answer(NamedTuple):
    """What a solver found."""

    z: Array | None  # solution, shape (n,); None if there is none
    y: Array | None  # multipliers, positive at upper bounds, shape (m,); None if unknown
    reason: str  # why it stopped early or failed, or empty


class QPSolver(Protocol):
    """A solver with a fixed pattern of rows."""

    def solve(self, program: Program, *, fine: bool = False) -> Answer:
        """Solve a program; `fine` says that the usual tolerance was not enough."""

    def reset(self) -> None:
        """Forget earlier problems."""


SolverFactory = Callable[[Array, sparse.csc_matrix, float], QPSolver]


def make_solver(
    solver: str | SolverFactory, weights: Array, matrix: sparse.csc_matrix, time_limit: float
) -> QPSolver:
    """Build a solver.

    Args:
        solver: "osqp", the name of any solver installed for qpsolvers, or a factory called with the
            other arguments.
        weights: Diagonal of `P`, shape (n,).
        matrix: `A`, shape (m, n).
        time_limit: Longest time for one problem [s], for solvers that have such a limit.

    Raises:
        InvalidProblem: The name is not known or not installed.
    """
    if callable(solver):
        return solver(weights, matrix, time_limit)
    if solver == "osqp":
        return OsqpSolver(weights, matrix, time_limit)
    if solver in qpsolvers.available_solvers:
        return QpsolversSolver(solver, weights, matrix, time_limit)
    raise InvalidProblem(
        f"`solver` must be one of {sorted({'osqp', *qpsolvers.available_solvers})}. Got {solver!r}."
    )


class OsqpSolver:
    """OSQP with a workspace that lives as long as this object and starts warm; keeps time limits.

    The arguments are those of `make_solver`.
    """

    def __init__(self, weights: Array, matrix: sparse.csc_matrix, time_limit: float) -> None:
        self._weights, self._matrix, self._time_limit = weights, matrix.copy(), time_limit
        self._set_up()

    def reset(self) -> None:
        """Forget earlier problems, here rather than in the next step, which must not wait."""
        if not self._is_cold:
            self._set_up()

    def _set_up(self) -> None:
        bound = np.ones(self._matrix.shape[0])
        start = Program(np.zeros(self._matrix.shape[1]), -bound, bound)
        # A multiple of the checks, never the clock: same input, same iterations.
        self._workspace = self._new_workspace(start, COARSE, adaptive_rho_interval=50)
        self._is_cold, self._is_fine = True, False

    def _new_workspace(self, program: Program, tolerance: float, **more: Any) -> osqp.OSQP:
        workspace = osqp.OSQP()
        workspace.setup(
            sparse.diags(self._weights, format="csc"),
            program.q,
            self._matrix,
            program.lower,
            program.upper,
            eps_abs=tolerance,
            eps_rel=tolerance,
            max_iter=_MAX_ITERATIONS,
            time_limit=self._time_limit,
            check_termination=10,
            polishing=True,
            verbose=False,
            **more,
        )
        return workspace

    def solve(self, program: Program, *, fine: bool = False) -> Answer:
        """Update the workspace and solve."""
        self._is_cold = False
        if fine is not self._is_fine:
            tolerance = FINE if fine else COARSE
            self._workspace.update_settings(eps_abs=tolerance, eps_rel=tolerance)
            self._is_fine = fine
        try:
            if program.entries is not None:
                self._matrix.data[:] = program.entries
                self._workspace.update(Ax=program.entries)
            self._workspace.update(q=program.q, l=program.lower, u=program.upper)
            result = self._workspace.solve(raise_error=False)
            if result.info.status == "maximum iterations reached":
                # The adapted step size can run to its bound and stay there: again with a fixed one.
                tolerance = FINE if fine else COARSE
                fixed = self._new_workspace(program, tolerance, adaptive_rho=False, rho=1.0)
                result = min(result, fixed.solve(raise_error=False), key=_is_unsolved)
        except osqp.OSQPException as error:
            self._set_up()
            return Answer(None, None, f"osqp failed with code {error}")
        status = result.info.status
        if status == "solved":
            return Answer(result.x, result.y, "")
        usable = np.isfinite(result.x).all() and np.isfinite(result.y).all()
        if not usable:
            self._set_up()
        if not usable or "infeasible" in status:
            return Answer(None, None, f"osqp gave no solution: {status}")
        return Answer(result.x, result.y, f"osqp stopped early: {status}")


def _is_unsolved(result: Any) -> bool:
    return bool(result.info.status != "solved")


class QpsolversSolver:
    """Any solver of qpsolvers, called from a cold start: for comparison and as an oracle in tests.

    It runs in the calling thread, with Python's lock held. "clarabel", "daqp", "highs" and "scs"
    are given the time limit and keep it, "piqp" and "proxqp" a limit of iterations. The others know
    no limit: for a deadline take OSQP. The arguments are those of `make_solver`.
    """

    def __init__(
        self, name: str, weights: Array, matrix: sparse.csc_matrix, time_limit: float
    ) -> None:
        self._name = name
        self._options: dict[str, Any] = dict(_OPTIONS.get(name, {}))
        if name in _TIME_LIMITS:
            self._options[_TIME_LIMITS[name]] = time_limit
        self._matrix = matrix.copy()
        is_dense = name in qpsolvers.dense_solvers or name not in qpsolvers.sparse_solvers
        self._pack: Callable[[Array], Any] = np.asarray if is_dense else sparse.csc_matrix
        self._hessian = self._pack(np.diag(weights))

    def reset(self) -> None:
        """Every problem starts cold: there is nothing to forget."""

    def solve(self, program: Program, *, fine: bool = False) -> Answer:
        """Solve from scratch."""
        if program.entries is not None:
            self._matrix.data[:] = program.entries
        rows, lower, upper = self._matrix.toarray(), program.lower, program.upper
        # What is divided by a small number is still no bound.
        above, below = upper < 1e-6 * UNBOUNDED, lower > -1e-6 * UNBOUNDED
        inequality = self._pack(np.vstack([rows[above], -rows[below]]))
        bound = np.concatenate([upper[above], -lower[below]])
        try:
            problem = qpsolvers.Problem(self._hessian, program.q, inequality, bound)
            solution = qpsolvers.solve_problem(problem, self._name, **self._options)
        except QPError as error:
            return Answer(None, None, f"{self._name} failed: {type(error).__name__}: {error}")
        if solution.x is None or not np.isfinite(solution.x).all():
            return Answer(None, None, f"{self._name} gave no solution")
        y = np.zeros(len(lower))
        if solution.z is not None:
            y[above] += solution.z[: above.sum()]
            y[below] -= solution.z[above.sum() :]
        reason = "" if solution.found else f"{self._name} stopped early"
        return Answer(solution.x, y, reason)
