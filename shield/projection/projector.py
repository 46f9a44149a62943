"""The nearest admissible horizon: solve, repair, check, certify."""

import math
import reprlib
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from shield.errors import Array, InvalidProblem, as_array, check_positive
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.box import BoxLimit
from shield.limits.constraint import Constraint, RowStack
from shield.limits.lateral import LateralLimit
from shield.limits.rate import RateLimit
from shield.projection.certificate import Projection, Status
from shield.projection.fallback import braking_targets
from shield.projection.repair import is_admissible, repair, worst_excess
from shield.projection.solvers import Answer, Program, QPSolver, SolverFactory, make_solver

__all__ = ["HorizonProjector"]

_MAX_PROGRAMS = 12  # [-] linearisations of one call; four are enough for 99 % of bending problems
_FAR = 1e7  # [steps] targets further away pull no harder: the digits of float64 end there
_LARGEST_SCALE = 100.0  # [steps] unit of the solver: the distance to the target, up to this
_SOFT = 1e3  # [-] weight of breaking a row of the caller's, where not all rows can be kept
_MAX_VERIFIED = 64  # [-] variables up to which we compute multipliers, in their third power of time
_INADMISSIBLE = (
    "the previous command is inadmissible: the box holds, the rest is approached at full rate"
)
_TOO_MUCH = "the constraints cannot be kept together with the limits"


class _Judged(NamedTuple):
    """A repaired horizon and how good it is."""

    commands: list[float]  # flat, length 2 H
    verified: bool  # whether it is the nearest, to the tolerance
    broken: float  # largest excess of the caller's scaled rows over the tolerance [steps]
    distance: float  # half the weighted squared distance to the target [steps²]


class HorizonProjector:
    r"""Projects horizons onto G1, G2, G3 and constraints of the caller's own.

    The answer minimises :math:`\tfrac12\sum_t w_\delta(\delta_t-\bar\delta_t)^2 +
    w_v(v_t-\bar v_t)^2` subject to the rows of all constraints, linearised again and again where
    they are not linear. Whatever the solver does, the forward repair makes G1, G2 and G3 hold on
    the float64 values returned; rows of the caller's hold to the tolerance where they can be kept
    together with the limits, else they are broken as little as possible. An answer counts as
    projected only if its duality gap says so. Objects are not safe to share between threads.

    Args:
        limits: Limits of the vehicle.
        horizon: Number of steps H.
        solver: "osqp", which keeps the deadline, or any solver installed for qpsolvers (see
            `QpsolversSolver` for which of those do), or a factory (see `make_solver`).
        constraints: Constraints on top of the limits, objects with a method
            ``rows(actions, previous) -> Rows``.
        weights: Weights of steering [1/rad²] and speed [1/(m/s)²] in the distance, (2,).
            Default: distances are measured in steps, the largest changes of the actuators in one
            period.
        tolerance: Duality gap, as a share of the objective, up to which an answer counts as the
            nearest, and distance [steps] up to which a row of the caller's counts as kept.
        deadline: Longest time for one call of `project` [s]. Default: half of a 10 Hz period.

    Raises:
        InvalidProblem: An argument makes no sense, or a constraint returns rows of a wrong shape.
    """

    def __init__(
        self,
        limits: ActuatorLimits,
        horizon: int,
        solver: str | SolverFactory = "osqp",
        *,
        constraints: Sequence[Constraint] = (),
        weights: tuple[float, float] | None = None,
        tolerance: float = 1e-6,
        deadline: float = 0.05,
    ) -> None:
        if not isinstance(limits, ActuatorLimits):
            raise InvalidProblem(f"`limits` must be ActuatorLimits. Got {limits!r}.")
        if isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)) or horizon < 1:
            raise InvalidProblem(
                f"`horizon` must be a positive integer. Got {reprlib.repr(horizon)}."
            )
        check_positive(InvalidProblem, tolerance=tolerance, deadline=deadline)
        self.limits, self.horizon = limits, int(horizon)
        self.weights = limits.step_weights if weights is None else _checked_weights(weights)
        self.deadline, self.tolerance = float(deadline), float(tolerance)
        self.constraints = tuple(constraints)
        self._choice = solver
        own: list[Constraint] = [BoxLimit(limits, horizon), RateLimit(limits, horizon)]
        if limits.max_lateral_acceleration is not None:
            own.append(LateralLimit(limits, horizon))
        self._built_in = len(own)
        # Rows of G1 and G2 are the same at every horizon.
        self._is_linear = len(own) == 2 and not self.constraints
        self._scale = np.tile(limits.step, self.horizon)
        self._diagonal = np.tile(self.weights * limits.step**2, self.horizon)
        self._rows = RowStack([*own, *self.constraints], self.horizon, limits.step)
        self._solver = self._make_solver()
        self._soft: QPSolver | None = None
        self._is_stale = False  # whether the solver has yet to see the entries of the rows

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy by building anew: a solver's workspace cannot be copied."""
        names = ("constraints", "weights", "tolerance", "deadline")
        options = {name: getattr(self, name) for name in names}
        return _build, (self.limits, self.horizon, self._choice, options)

    def reset(self) -> None:
        """Forget earlier horizons.

        After a reset the same horizons in the same order give the same answers, bit by bit, as long
        as no deadline cuts one short.
        """
        self._solver.reset()
        self._soft = None

    @np.errstate(all="ignore")
    def project(self, nominal: ArrayLike, previous: ArrayLike) -> Projection:
        """Return the nearest admissible horizon; admissible nominals come back bit by bit.

        Args:
            nominal: Commands to be near to [rad, m/s], shape (H, 2), any values.
            previous: Last executed command [rad, m/s], shape (2,), any values.

        Raises:
            InvalidProblem: A shape or a type does not fit.
        """
        begin = time.perf_counter()
        target = as_array("nominal", nominal, (self.horizon, 2))
        last = as_array("previous", previous, (2,))
        steering, speed, note = self._usable_previous(*last.tolist())
        flat: list[float] = target.ravel().tolist()
        finite = math.isfinite(sum(flat)) or all(map(math.isfinite, flat))
        if not finite:
            commands, status, reason = self._brake(flat, steering, speed)
        elif not note and self._keeps_all(target, flat, steering, speed):
            commands, status, reason = flat, Status.NOMINAL, ""
        else:
            commands, status, reason = self._nearest(flat, steering, speed, begin)
        excess = worst_excess(self.limits, commands, steering, speed)
        if note or excess > 0.0:
            status = Status.FALLBACK
            parts = (note, _INADMISSIBLE if excess > 0.0 else "", reason)
            reason = "; ".join(part for part in parts if part)
        actions = np.array(commands).reshape(self.horizon, 2)
        correction = actions - target
        violations = self._violations(actions, np.array([steering, speed]))
        actions.flags.writeable = False
        correction.flags.writeable = False
        elapsed = time.perf_counter() - begin
        return Projection(actions, status, correction, excess, elapsed, reason, violations)

    def project_batch(self, nominals: ArrayLike, previous: ArrayLike) -> tuple[Projection, ...]:
        """Project B horizons, one after the other, each with a deadline of its own.

        Args:
            nominals: Commands to be near to [rad, m/s], shape (B, H, 2), any values.
            previous: Last executed command, shape (2,) for all or (B, 2) [rad, m/s].

        Raises:
            InvalidProblem: A shape or a type does not fit.
        """
        targets = as_array("nominals", nominals)
        if targets.ndim != 3 or targets.shape[1:] != (self.horizon, 2):
            raise InvalidProblem(
                f"`nominals` must have shape (B, {self.horizon}, 2). Got {targets.shape}."
            )
        lasts = as_array("previous", previous)
        if lasts.shape not in {(2,), (len(targets), 2)}:
            raise InvalidProblem(
                f"`previous` must have shape (2,) or ({len(targets)}, 2). Got {lasts.shape}."
            )
        pairs = zip(targets, np.broadcast_to(lasts, (len(targets), 2)), strict=True)
        return tuple(self.project(target, last) for target, last in pairs)

    def _usable_previous(self, steering: float, speed: float) -> tuple[float, float, str]:
        """Return a finite previous command, and a note when it had to be assumed."""
        if math.isfinite(steering) and math.isfinite(speed):
            return steering, speed, ""
        given = np.nan_to_num([steering, speed], nan=0.0, posinf=math.inf, neginf=-math.inf)
        turned, moving = np.clip(given, self.limits.low, self.limits.high).tolist()
        note = f"the previous command ({steering}, {speed}) is not finite: "
        return turned, moving, note + f"({turned:g}, {moving:g}) assumed"

    def _brake(
        self, flat: list[float], steering: float, speed: float
    ) -> tuple[list[float], Status, str]:
        """Return full braking, for a nominal that is not finite somewhere."""
        index, value = next(item for item in enumerate(flat) if not math.isfinite(item[1]))
        targets = braking_targets(self.limits, steering, self.horizon)
        commands = repair(self.limits, targets, steering, speed).commands
        reason = f"nominal[{index // 2}, {index % 2}] is {value}: braking"
        return commands, Status.FALLBACK, reason

    def _keeps_all(self, target: Array, flat: list[float], steering: float, speed: float) -> bool:
        """Tell whether a horizon keeps the limits exactly and other rows to the tolerance."""
        if not is_admissible(self.limits, flat, steering, speed):
            return False
        if not self.constraints:
            return True
        self._take_rows(target, np.array([steering, speed]))
        return self._broken(target.ravel() / self._scale) == 0.0

    def _nearest(
        self, flat: list[float], steering: float, speed: float, begin: float
    ) -> tuple[list[float], Status, str]:
        """Return the nearest horizon for a finite nominal that is not admissible."""
        far = self._scale * _FAR
        goal = np.clip(np.array(flat), -far, far)
        start = repair(self.limits, goal.tolist(), steering, speed, self.weights)
        if not start.complete:
            return start.commands, Status.FALLBACK, ""
        if self.horizon == 1 and not (self.constraints or start.lateral_active):
            # One command in a rectangle: the nearest is what the repair clips to.
            return start.commands, Status.PROJECTED, ""
        judged, reason = self._improve(start.commands, goal, np.array([steering, speed]), begin)
        if judged.verified:
            return judged.commands, Status.PROJECTED, ""
        return judged.commands, Status.REPAIRED, reason or "the optimum could not be verified"

    def _improve(
        self, start: list[float], goal: Array, previous: Array, begin: float
    ) -> tuple[_Judged, str]:
        """Return the best horizon that the solver and the repair come to, and what went wrong."""
        target, origin = goal / self._scale, np.array(start) / self._scale
        steering, speed = previous.tolist()
        self._take_rows(np.array(start), previous)
        shift = target - origin
        distance, broken = 0.5 * float((self._diagonal * shift) @ shift), self._broken(origin)
        best = _Judged(start, distance <= self.tolerance**2 and not broken, broken, distance)
        reason = ""
        if self.horizon == 1 and not best.verified:
            # The nearest single command is nearly always what the repair finds.
            best = self._verify(best, target)
        changed = soft = False
        for program in range(_MAX_PROGRAMS):
            # The same rows once more only help with a finer tolerance, then without a warm start:
            # that of another problem misleads the polishing twice in 10,000 random horizons.
            if best.verified or (program > 2 and not changed):
                return best, reason
            if program == 2 and not changed:
                (self._soft if soft and self._soft else self._solver).reset()
            if self.constraints and not self._rows.is_usable():
                return best, "the rows of a constraint are not usable"
            if time.perf_counter() > begin + 0.5 * self.deadline:
                return best, "; ".join(filter(None, (reason, "stopped at the deadline")))
            answer = self._solve(shift, origin, soft=soft, fine=program > 0)
            if answer.z is None and self.constraints and not soft:
                # Not all rows can be kept: those of the caller's own get a slack with a price.
                soft = changed = True
                continue
            reason = answer.reason
            if answer.z is None:
                self._take_rows(np.array(best.commands), previous)
                return self._verify(best, target), reason
            moved = ((origin + answer.z) * self._scale).tolist()
            candidate = repair(self.limits, moved, steering, speed, self.weights).commands
            changed = not self._is_linear and self._take_rows(np.array(candidate), previous)
            judged = self._judge(candidate, target, answer.y)
            gain = (best.broken - judged.broken, best.distance - judged.distance)
            if soft and not judged.verified:
                reason, changed = reason or _TOO_MUCH, changed and max(gain) > self.tolerance
            if judged.verified or gain > (0.0, 0.0):
                best = judged
        return best, reason

    def _solve(self, shift: Array, origin: Array, *, soft: bool, fine: bool) -> Answer:
        """Solve for the displacement from `origin` nearest to `shift`, rows `soft` or not."""
        rows = self._rows
        # Far away targets shrink to a distance that the solver's tolerances are made for.
        scale = min(float(np.abs(shift).max()), _LARGEST_SCALE) or 1.0
        q = self._diagonal * shift / -scale
        at_origin = rows.times(origin)
        lower, upper = (rows.lower - at_origin) / scale, (rows.upper - at_origin) / scale
        if soft:
            slacks = len(lower) - rows.spans[self._built_in].start
            if self._soft is None:
                self._soft = self._make_solver(slacks)
            entries = np.concatenate([rows.value, np.ones(slacks)])
            padded = np.concatenate([q, np.zeros(slacks)])
            answer = self._soft.solve(Program(padded, lower, upper, entries), fine=fine)
        else:
            stale, self._is_stale = self._is_stale, False
            program = Program(q, lower, upper, rows.value if stale else None)
            answer = self._solver.solve(program, fine=fine)
        if answer.z is None:
            return answer
        y = None if answer.y is None else scale * answer.y
        return Answer(scale * answer.z[: len(q)], y, answer.reason)

    def _make_solver(self, slacks: int = 0) -> QPSolver:
        """Build a solver for the pattern of the rows; the last `slacks` rows get a slack each."""
        rows = self._rows
        count, size = len(rows.norm), 2 * self.horizon
        matrix = sparse.csc_matrix(
            (
                np.concatenate([rows.value, np.ones(slacks)]),
                np.concatenate([rows.row, np.arange(count - slacks, count)]),
                np.concatenate([rows.starts, rows.starts[-1] + 1 + np.arange(slacks)]),
            ),
            shape=(count, size + slacks),
        )
        weights = np.concatenate([self._diagonal, np.full(slacks, _SOFT * self._diagonal.max())])
        return make_solver(self._choice, weights, matrix, 0.25 * self.deadline)

    def _take_rows(self, actions: Array, previous: Array) -> bool:
        """Evaluate all constraints at a horizon; tell whether the matrix changed."""
        changed, laid_out = self._rows.evaluate(actions.reshape(-1, 2), previous)
        if laid_out:
            self._solver, self._soft = self._make_solver(), None
        self._is_stale = (self._is_stale or changed) and not laid_out
        return changed

    def _judge(self, commands: list[float], target: Array, y: Array | None) -> _Judged:
        """Judge a repaired horizon at which the rows were just evaluated."""
        y = np.zeros(len(self._rows.norm)) if y is None else y
        z = np.array(commands) / self._scale
        difference = z - target
        distance = 0.5 * float((self._diagonal * difference) @ difference)
        gap = self._rows.duality_gap(z, target, self._diagonal, y)
        broken = self._broken(z)
        close = gap <= self.tolerance * distance + self.tolerance**2
        return _Judged(commands, close and broken == 0.0, broken, distance)

    def _broken(self, z: Array) -> float:
        """Return by how much more than the tolerance the caller's own rows are broken [steps]."""
        if not self.constraints:
            return 0.0
        first = self._rows.spans[self._built_in].start
        excess = self._rows.excess(z)[first:]
        return float(np.maximum(excess - self.tolerance, 0.0).max(initial=0.0))

    def _verify(self, judged: _Judged, target: Array) -> _Judged:
        """Judge a horizon as `_judge` does, if it is short, by multipliers of its active rows."""
        if 2 * self.horizon > _MAX_VERIFIED or not self._rows.is_usable():
            return judged
        z = np.array(judged.commands) / self._scale
        y = self._rows.multipliers(z, target, self._diagonal)
        return self._judge(judged.commands, target, y)

    def _violations(self, actions: Array, previous: Array) -> tuple[float, ...]:
        """Return the largest excess of each of the caller's constraints in units of its rows."""
        if not self.constraints:
            return ()
        self._take_rows(actions, previous)
        excess = self._rows.excess(actions.ravel() / self._scale) * self._rows.norm
        spans = self._rows.spans[self._built_in :]
        return tuple(float(excess[span].max(initial=0.0)) for span in spans)


def _build(
    limits: ActuatorLimits, horizon: int, solver: str | SolverFactory, options: dict[str, Any]
) -> HorizonProjector:
    return HorizonProjector(limits, horizon, solver, **options)


def _checked_weights(weights: ArrayLike) -> tuple[float, float]:
    """Return weights as plain numbers, or refuse them."""
    pair = as_array("weights", weights)
    if pair.shape != (2,) or not ((pair >= 1e-9) & (pair <= 1e9)).all():
        raise InvalidProblem(
            f"`weights` must be two numbers in [1e-9, 1e9]. Got {reprlib.repr(weights)}."
        )
    return float(pair[0]), float(pair[1])
