r"""Quadratic program solvers behind one method.

The problem is :math:`\min_z \tfrac12 z^\top P z + q^\top z` subject to
:math:`l \le A z \le u`, with `P` diagonal and fixed, the pattern of `A` fixed, and everything else
changing from call to call. A solver never raises: it answers ``(z, "")``, or ``(z, reason)`` when
it stopped before its tolerance, or ``(None, reason)`` when it has nothing to offer.
"""

import queue
import threading
import weakref
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import osqp
import qpsolvers
from numpy.typing import NDArray
from qpsolvers.exceptions import QPError
from scipy import sparse

from shield.arguments import as_array
from shield.errors import InvalidProblem
from shield.limits.constraints import UNBOUNDED

__all__ = [
    "FAILURES",
    "Answer",
    "DeadlineSolver",
    "OsqpSolver",
    "QPSolver",
    "QpsolversSolver",
    "SolverFactory",
    "make_solver",
]

Array = NDArray[np.float64]
Answer = tuple[Array | None, str]
_Problems = queue.SimpleQueue[tuple[Any, ...] | None]

# What a solver and its bindings raise when they fail. Interrupts and exits are the user's.
FAILURES: tuple[type[Exception], ...] = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    BufferError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    QPError,
    osqp.OSQPException,
)


# Solvers of qpsolvers hold Python's lock while they work, so each stops by itself: by the clock
# where it has one, else by its count of iterations, several times what our problems take.
_TIME_LIMITS = {
    "clarabel": "time_limit",
    "daqp": "time_limit",
    "highs": "time_limit",
    "scs": "time_limit_secs",
}
_ITERATIONS: dict[str, dict[str, int]] = {
    "piqp": {"max_iter": 100},
    "proxqp": {"max_iter": 100},
}


class QPSolver(Protocol):
    """A solver with a fixed pattern of rows."""

    def solve(self, q: Array, lower: Array, upper: Array, matrix: Array | None = None) -> Answer:
        """Solve the problem with new vectors and, if given, new entries of `A`.

        Args:
            q: Shape (n,).
            lower: Shape (m,).
            upper: Shape (m,), nowhere below `lower`.
            matrix: Entries of `A` in the order of its CSC pattern; None keeps them.
        """
        ...


SolverFactory = Callable[[Array, sparse.csc_matrix, float, float], QPSolver]


def make_solver(
    solver: str | SolverFactory,
    weights: Array,
    pattern: sparse.csc_matrix,
    tolerance: float,
    deadline: float,
) -> "OsqpSolver | DeadlineSolver":
    """Build a solver that respects a deadline.

    Args:
        solver: "osqp", the name of any solver installed for qpsolvers, or a factory called with the
            other arguments.
        weights: Diagonal of `P`, shape (n,).
        pattern: `A` with its entries, shape (m, n).
        tolerance: Absolute and relative tolerance, for solvers that have one.
        deadline: Longest time for one problem [s].

    Returns:
        OSQP, which watches the time itself, or another solver in a `DeadlineSolver`.

    Raises:
        InvalidProblem: The name is not known or not installed, or the factory fails.
    """
    if callable(solver):
        try:
            built = solver(weights, pattern, tolerance, deadline)
        except FAILURES as error:
            raise InvalidProblem(
                f"`solver` must build a solver. Got {type(error).__name__}: {error}."
            ) from error
        return DeadlineSolver(built, deadline)
    if solver == "osqp":
        return OsqpSolver(weights, pattern, tolerance, deadline)
    if solver in qpsolvers.available_solvers:
        return DeadlineSolver(QpsolversSolver(solver, weights, pattern, deadline), deadline)
    raise InvalidProblem(
        f"`solver` must be one of {sorted({'osqp', *qpsolvers.available_solvers})}. Got {solver!r}."
    )


class _Info:
    """The two fields of OSQP's information that are read here."""

    __slots__ = ("status", "status_val")

    def __init__(self, info: Any) -> None:
        self.status = info.status
        self.status_val = info.status_val


class _Solution:
    """The primal solution alone."""

    __slots__ = ("dual_inf_cert", "prim_inf_cert", "x", "y")

    def __init__(self, solution: Any) -> None:
        self.x = solution.x
        self.y = self.prim_inf_cert = self.dual_inf_cert = None


class _LeanSolver:
    """OSQP's compiled solver, showing no more of an answer than is read here.

    OSQP's `solve` copies all that `info` and `solution` hold into Python objects, which takes as
    long as fifteen iterations of a small problem.
    """

    def __init__(self, solver: Any) -> None:
        self._solver = solver
        self.update_data_vec = solver.update_data_vec
        self.update_data_mat = solver.update_data_mat

    def solve(self) -> None:
        """Solve and read the answer off, once."""
        self._solver.solve()
        self.info = _Info(self._solver.info)
        self.solution = _Solution(self._solver.solution)


class _Workspace(osqp.OSQP):  # type: ignore[misc]
    """OSQP's Python object with a leaner way in and out.

    Its own `update` clips the bounds to OSQP's infinity and looks that up by importing a module,
    each time; the bounds here are finite.
    """

    def setup(self, *args: Any, **settings: Any) -> None:
        """Set up as OSQP does."""
        super().setup(*args, **settings)
        self._solver: Any = _LeanSolver(self._solver)

    def replace(self, q: Array, lower: Array, upper: Array, matrix: Array | None) -> None:
        """Replace the vectors and, if given, the entries of the matrix."""
        self._solver.update_data_vec(q=q, l=lower, u=upper)
        if matrix is not None:
            self._solver.update_data_mat(P_x=None, P_i=None, A_x=matrix, A_i=None)


class OsqpSolver:
    """OSQP with a workspace that lives as long as this object and starts warm.

    Args:
        weights: Diagonal of `P`.
        pattern: `A` with its entries.
        tolerance: OSQP's absolute and relative tolerance.
        deadline: OSQP's time limit [s].
        max_iterations: OSQP's iteration limit.

    Attributes:
        settings: What OSQP is set up with.
    """

    def __init__(
        self,
        weights: Array,
        pattern: sparse.csc_matrix,
        tolerance: float,
        deadline: float,
        max_iterations: int = 4000,
    ) -> None:
        self._weights = weights
        self._pattern = pattern.copy()
        self.settings: dict[str, Any] = {
            "eps_abs": tolerance,
            "eps_rel": tolerance,
            "max_iter": max_iterations,
            "time_limit": deadline,
            # A multiple of the checks, never the clock: same input, same iterations.
            "adaptive_rho_interval": 50,
            "check_termination": 10,
            "polishing": False,
            "verbose": False,
        }
        self._workspace: _Workspace | None = self._set_up()
        self._is_cold = True

    def reset(self) -> None:
        """Forget earlier problems: they no longer change an answer, not even in its last bit.

        What is set up anew is set up here, so that the next problem does not wait for it.
        """
        if self._is_cold:
            return
        try:
            self._workspace, self._is_cold = self._set_up(), True
        except FAILURES:
            self._workspace = None  # the next problem tries again, and answers why it cannot

    def _set_up(self) -> _Workspace:
        rows, columns = self._pattern.shape
        workspace = _Workspace()
        workspace.setup(
            sparse.diags(self._weights, format="csc"),
            np.zeros(columns),
            self._pattern,
            np.full(rows, -1.0),
            np.full(rows, 1.0),
            **self.settings,
        )
        return workspace

    def solve(self, q: Array, lower: Array, upper: Array, matrix: Array | None = None) -> Answer:
        """Update the workspace and solve; a failure costs the workspace, which is then rebuilt."""
        self._is_cold = False
        try:
            if self._workspace is None:
                self._workspace = self._set_up()
            self._workspace.replace(q, lower, upper, matrix)
            result = self._workspace.solve(raise_error=False)
            status, solution = result.info.status, result.x
            if status == "solved" and solution.shape == q.shape:
                return solution, ""
            usable = np.shape(solution) == q.shape and bool(np.isfinite(solution).all())
        except FAILURES as error:
            self._workspace = None
            return None, f"osqp failed: {type(error).__name__}: {error}"
        if not usable:
            self._workspace = None
            return None, f"osqp gave no solution: {status}"
        return solution, f"osqp stopped early: {status}"


class QpsolversSolver:
    """Any solver of qpsolvers, from a cold start: for comparison and as an oracle in tests.

    Args:
        name: One of `qpsolvers.available_solvers`.
        weights: Diagonal of `P`.
        pattern: `A` with its entries.
        deadline: Time limit, for solvers that have one [s].
    """

    def __init__(
        self, name: str, weights: Array, pattern: sparse.csc_matrix, deadline: float
    ) -> None:
        self._name = name
        self._options: dict[str, Any] = dict(_ITERATIONS.get(name, {}))
        if name in _TIME_LIMITS:
            self._options[_TIME_LIMITS[name]] = deadline
        self._matrix = pattern.copy()
        self._hessian: Any = np.diag(weights)
        self._is_sparse = name in qpsolvers.sparse_solvers and name not in qpsolvers.dense_solvers
        if self._is_sparse:
            self._hessian = sparse.csc_matrix(self._hessian)

    def solve(self, q: Array, lower: Array, upper: Array, matrix: Array | None = None) -> Answer:
        """Solve from scratch."""
        if matrix is not None:
            self._matrix.data[:] = matrix
        rows = self._matrix.toarray()
        above, below = upper < UNBOUNDED, lower > -UNBOUNDED
        inequality: Any = np.vstack([rows[above], -rows[below]])
        if self._is_sparse:
            inequality = sparse.csc_matrix(inequality)
        bound = np.concatenate([upper[above], -lower[below]])
        try:
            problem = qpsolvers.Problem(self._hessian, q, inequality, bound)
            solution = qpsolvers.solve_problem(problem, self._name, **self._options)
        except FAILURES as error:
            return None, f"{self._name} failed: {type(error).__name__}: {error}"
        if solution.x is None or not np.isfinite(solution.x).all():
            return None, f"{self._name} gave no solution"
        return solution.x, "" if solution.found else f"{self._name} stopped early"


def _checked(answer: Any, shape: tuple[int, ...]) -> Answer:
    """Return what a solver answered if it is an answer, else why it is none."""
    if not isinstance(answer, tuple) or len(answer) != 2 or not isinstance(answer[1], str):
        return None, f"the solver answered {type(answer).__name__}, not (z, reason)"
    z, reason = answer
    if z is None:
        return None, reason or "the solver gave no solution"
    try:
        return as_array("z", z, shape), reason
    except InvalidProblem as error:
        return None, f"the solver's answer is unusable: {error}"


class DeadlineSolver:
    """Runs a solver in a thread of its own and stops waiting at the deadline.

    A solver that overran is left to finish; until it has, further problems go unanswered. A solver
    that holds Python's lock while it works cannot be timed out this way; small quadratic programs
    take such solvers microseconds.

    Args:
        solver: The solver to watch.
        deadline: Longest time for one problem [s].
    """

    def __init__(self, solver: QPSolver, deadline: float) -> None:
        self._solver = solver
        self._deadline = deadline
        self._problems: _Problems = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        self._working = threading.Event()
        self._late = False
        # The thread knows the queues, not this object, so that it can end with it.
        weakref.finalize(self, self._problems.put, None)

    def reset(self) -> None:
        """Solvers of qpsolvers have nothing to forget; what a factory's own remembers, stays."""

    def solve(self, q: Array, lower: Array, upper: Array, matrix: Array | None = None) -> Answer:
        """Hand the problem over and wait for the answer, at most until the deadline."""
        try:
            if self._late:
                self._answers.get_nowait()
                self._late = False
            if not self._working.is_set():
                self._start()
            # Copies: a late solver must not read what the next problem writes.
            entries = None if matrix is None else matrix.copy()
            self._problems.put((q.copy(), lower.copy(), upper.copy(), entries))
            return self._answers.get(timeout=self._deadline)
        except queue.Empty:
            self._late = True
            return None, f"the solver ran past its deadline of {self._deadline:g} s"
        except RuntimeError as error:
            return None, f"the solver has no thread: {error}"

    def _start(self) -> None:
        """Start a thread; the flag says whether it still waits for problems."""
        arguments = (self._solver, self._problems, self._answers, self._working)
        threading.Thread(target=_serve, args=arguments, daemon=True).start()
        self._working.set()


def _serve(
    solver: QPSolver,
    problems: "_Problems",
    answers: "queue.SimpleQueue[Answer]",
    working: threading.Event,
) -> None:
    """Answer problems until there is a None among them."""
    while (problem := problems.get()) is not None:
        # What is not among the failures ends this thread, never the caller's loop.
        answer: Answer = None, "the solver failed with an exception of its own"
        survived = False
        try:
            answer = _checked(solver.solve(*problem), problem[0].shape)
            survived = True
        except FAILURES as error:
            answer = None, f"the solver failed: {type(error).__name__}: {error}"
            survived = True
        finally:
            if not survived:
                working.clear()
            answers.put(answer)
