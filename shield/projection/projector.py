"""The nearest admissible horizon: solve, settle, repair, check."""

import math
import reprlib
import time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from shield.arguments import as_array, check_positive
from shield.errors import InvalidProblem
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraints import BoxLimit, RateLimit, stack_rows
from shield.projection.batch import BatchEngine
from shield.projection.certificate import BatchProjection, Projection, Status
from shield.projection.chain import ChainBounds, is_optimal, settle_chain, solve_chain
from shield.projection.fallback import braking_targets
from shield.projection.repair import Bounds, is_admissible, repair, worst_excess
from shield.projection.solvers import SolverFactory, make_solver
from shield.projection.successive import SuccessiveProjection

__all__ = ["HorizonProjector"]

Array = NDArray[np.float64]

# Targets this many box widths away pull as hard as any; further ones would only lose digits.
_FAR = 1e9
# The solver, and all that deals with bends, sees targets no further than this; the exact part of
# G1 and G2 sees them as they are.
_NEAR = 10.0
# In units of a channel's step: tolerance of the solver, which only has to find the active bounds;
# distance to a bound that counts as active; error of a certified optimum.
_SEARCH, _ACTIVE, _CERTIFIED = 1e-3, 1e-2, 1e-9
# Horizons of a batch that share one deadline.
_PER_DEADLINE = 64
_INADMISSIBLE = (
    "the previous command is inadmissible: the box holds, the rest is approached at full rate"
)


class HorizonProjector:
    r"""Projects horizons onto G1, G2 and G3.

    The answer minimises :math:`\tfrac12\sum_t w_\delta(\delta_t-\bar\delta_t)^2 +
    w_v(v_t-\bar v_t)^2` over the admissible horizons: exactly for G1 and G2, to a local optimum
    where G3 binds. Whatever the solver does, the forward repair makes every bound hold on the
    float64 values returned. Objects are not safe to share between threads.

    Args:
        limits: Limits of the vehicle.
        horizon: Number of steps H.
        solver: "osqp", or any solver installed for qpsolvers, or a factory (see `make_solver`).
        weights: Weights of steering and speed in the distance, (2,). They matter only where the
            lateral bound couples the two. Default: plain distance in rad and m/s.
        tolerance: Distance, in units of a step, by which the repair may move an answer that still
            counts as projected. Default: 1e-6.
        deadline: Longest time for one call of `project`, and for each 64 horizons, or part of them,
            of `project_batch` [s]. Default: half of a 10 Hz period.

    Raises:
        InvalidProblem: `horizon`, `solver`, `weights`, `tolerance` or `deadline` makes no sense.
    """

    def __init__(
        self,
        limits: ActuatorLimits,
        horizon: int,
        solver: str | SolverFactory = "osqp",
        *,
        weights: tuple[float, float] = (1.0, 1.0),
        tolerance: float = 1e-6,
        deadline: float = 0.05,
    ) -> None:
        if not isinstance(limits, ActuatorLimits):
            raise InvalidProblem(f"`limits` must be ActuatorLimits. Got {limits!r}.")
        self.limits = limits
        self.horizon, self.weights = _checked_arguments(horizon, weights, tolerance, deadline)
        self.deadline = float(deadline)
        self.tolerance = float(tolerance)
        bounds = self._bounds = Bounds.of(limits)
        step = bounds.steering_step
        self._channels = (
            ChainBounds(-bounds.max_steering, bounds.max_steering, step, step),
            ChainBounds(bounds.min_speed, bounds.max_speed, bounds.rise, bounds.fall),
        )
        self._units = (step, min(bounds.rise, bounds.fall))
        self._reach = 1.0 + 3.0 * max(abs(bounds.min_speed), abs(bounds.max_speed))
        self._diagonal = np.tile(self.weights, self.horizon)
        self._engine = BatchEngine(bounds, self.horizon, self.weights, _NEAR * self._reach)
        # The solver sees every channel in units of its step, whatever the vehicle.
        self._scale = np.tile(self._units, self.horizon)
        self._pull = -1.0 / self._scale
        rows = stack_rows(
            [BoxLimit(limits), RateLimit(limits)], np.zeros((self.horizon, 2)), np.zeros(2)
        )
        double = np.tile(self._scale, 2)
        self._lower, self._upper = rows.lower / double, rows.upper / double
        ones = np.ones(2 * self.horizon)
        matrix = sparse.csc_matrix(rows.matrix)
        self._solver = make_solver(solver, ones, matrix, _SEARCH, 0.4 * self.deadline)
        self._successive = (
            None
            if bounds.lateral is None
            else SuccessiveProjection(
                limits, self.horizon, solver, self.weights, 0.2 * self.deadline
            )
        )

    def reset(self) -> None:
        """Forget earlier horizons.

        The solver starts from its last answer. After a reset the same horizons in the same order
        give the same answers, bit by bit, as long as no deadline cuts one short.
        """
        self._solver.reset()
        if self._successive is not None:
            self._successive.reset()

    def project(self, nominal: ArrayLike, previous: ArrayLike) -> Projection:
        """Return the nearest admissible horizon.

        Args:
            nominal: Wanted commands [rad, m/s], shape (H, 2), any values.
            previous: Last executed command [rad, m/s], shape (2,), any values.

        Returns:
            The horizon with its status. Admissible nominals come back bit by bit.

        Raises:
            InvalidProblem: A shape or a type does not fit.
        """
        begin = time.perf_counter()
        wanted = as_array("nominal", nominal, (self.horizon, 2))
        last = as_array("previous", previous, (2,))
        return self._project(wanted, last, begin, begin + 0.5 * self.deadline)

    @np.errstate(all="ignore")
    def _project(self, wanted: Array, last: Array, begin: float, stop_at: float) -> Projection:
        """Return the nearest admissible horizon; no solver is started after `stop_at`."""
        steering, speed = last.tolist()
        flat: list[float] = wanted.ravel().tolist()
        note = ""
        if not math.isfinite(steering + speed):
            steering, speed, note = self._usable_previous(steering, speed)
        if not note and is_admissible(self._bounds, flat, steering, speed):
            commands, status, reason, excess = flat, Status.NOMINAL, "", 0.0
        else:
            commands, status, reason = self._answer(flat, steering, speed, stop_at)
            excess = worst_excess(self._bounds, commands, steering, speed)
            if note or excess > 0.0:
                status = Status.FALLBACK
                parts = (note, _INADMISSIBLE if excess > 0.0 else "", reason)
                reason = "; ".join(part for part in parts if part)
        actions = np.array(commands).reshape(self.horizon, 2)
        correction = actions - wanted
        actions.flags.writeable = False
        correction.flags.writeable = False
        return Projection(actions, status, correction, excess, time.perf_counter() - begin, reason)

    def project_batch(self, nominals: ArrayLike, previous: ArrayLike) -> BatchProjection:
        """Project B horizons at once.

        Args:
            nominals: Wanted commands [rad, m/s], shape (B, H, 2), any values.
            previous: Last executed command, shape (2,) for all or (B, 2) [rad, m/s].

        Returns:
            B horizons with their statuses.

        Raises:
            InvalidProblem: A shape or a type does not fit.
        """
        begin = time.perf_counter()
        wanted = as_array("nominals", nominals)
        if wanted.ndim != 3 or wanted.shape[1:] != (self.horizon, 2):
            raise InvalidProblem(
                f"`nominals` must have shape (B, {self.horizon}, 2). Got {wanted.shape}."
            )
        last = as_array("previous", previous)
        if last.shape not in {(2,), (len(wanted), 2)}:
            raise InvalidProblem(
                f"`previous` must have shape (2,) or ({len(wanted)}, 2). Got {last.shape}."
            )
        return self._project_batch(wanted, np.broadcast_to(last, (len(wanted), 2)), begin)

    @np.errstate(all="ignore")
    def _project_batch(self, wanted: Array, lasts: Array, begin: float) -> BatchProjection:
        """Project what fits in arrays at once, and what is left over one by one."""
        actions, nominal, solved = self._engine.solve(wanted, lasts)
        count = len(wanted)
        status = [Status.PROJECTED] * count
        for row in np.flatnonzero(nominal).tolist():
            status[row] = Status.NOMINAL
        reasons, excess = [""] * count, np.zeros(count)
        allowed = 0.4 * self.deadline * -(-count // _PER_DEADLINE)
        for row in np.flatnonzero(~(nominal | solved)).tolist():
            now = time.perf_counter()
            stop_at = min(begin + allowed, now + 0.5 * self.deadline)
            single = self._project(wanted[row], lasts[row], now, stop_at)
            actions[row], status[row] = single.actions, single.status
            reasons[row], excess[row] = single.reason, single.max_violation
        correction = actions - wanted
        for array in (actions, correction, excess):
            array.flags.writeable = False
        return BatchProjection(
            actions, tuple(status), correction, excess, time.perf_counter() - begin, tuple(reasons)
        )

    def objective(self, actions: ArrayLike, nominal: ArrayLike) -> float:
        """Return half the weighted squared distance between two horizons of shape (H, 2)."""
        difference = as_array("actions", actions) - as_array("nominal", nominal)
        return float(0.5 * np.sum(difference * difference * np.array(self.weights)))

    def _usable_previous(self, steering: float, speed: float) -> tuple[float, float, str]:
        """Return a finite previous command, and a note when it had to be assumed."""
        if math.isfinite(steering) and math.isfinite(speed):
            return steering, speed, ""
        bounds = self._bounds
        side = bounds.max_steering
        turned = 0.0 if math.isnan(steering) else min(max(steering, -side), side)
        moving = 0.0 if math.isnan(speed) else speed
        moving = min(max(moving, bounds.min_speed), bounds.max_speed)
        return (
            turned,
            moving,
            f"the previous command ({steering}, {speed}) is not finite: "
            f"({turned:g}, {moving:g}) assumed",
        )

    def _answer(
        self, flat: list[float], steering: float, speed: float, stop_at: float
    ) -> tuple[list[float], Status, str]:
        """Return the repaired horizon for a nominal that is not admissible."""
        # At least the largest value, at one call's cost; only where it is large look again.
        largest, near = math.hypot(*flat), _NEAR * self._reach
        if not largest <= near:
            if not all(map(math.isfinite, flat)):
                return self._brake(flat, steering, speed)
            far = _FAR * self._reach
            flat = [min(max(value, -far), far) for value in flat]
        if time.perf_counter() > stop_at:
            commands = repair(self._bounds, flat, steering, speed, self.weights).commands
            return commands, Status.REPAIRED, "stopped at the deadline"
        exact = shown = np.array(flat)
        if largest > near:
            shown = np.clip(exact, -near, near)
        self._set_previous(steering, speed)
        answer, reason = self._solver.solve(self._pull * shown, self._lower, self._upper)
        guess: list[float] | None = None if answer is None else (answer * self._scale).tolist()
        if guess is not None and not math.isfinite(sum(guess)):
            guess, reason = None, "the solver's answer is not finite"
        goal, replaced = self._settle(guess, flat, steering, speed)
        repaired = repair(self._bounds, goal, steering, speed, self.weights)
        if repaired.bent and repaired.complete and self._successive is not None:
            return self._bend(repaired.commands, shown, steering, speed, stop_at, reason)
        if guess is None:
            return repaired.commands, Status.FALLBACK, reason
        if replaced and not reason and shown is exact:
            off = self._distance(guess, goal)
            # What a solver at this tolerance may miss by, with pulls of this size.
            if off > 1.0 + 10.0 * _SEARCH * self._distance(flat, goal):
                reason = f"the solver was off by {off:.1e} steps: solved by dynamic programming"
        return repaired.commands, Status.REPAIRED if reason else Status.PROJECTED, reason

    def _brake(
        self, flat: list[float], steering: float, speed: float
    ) -> tuple[list[float], Status, str]:
        """Return full braking, for a nominal that is not finite somewhere."""
        index, value = next(item for item in enumerate(flat) if not math.isfinite(item[1]))
        targets = braking_targets(self._bounds, steering, self.horizon)
        commands = repair(self._bounds, targets, steering, speed).commands
        step, channel = divmod(index, 2)
        return commands, Status.FALLBACK, f"nominal[{step}, {channel}] is {value}: braking"

    def _settle(
        self, guess: list[float] | None, targets: list[float], steering: float, speed: float
    ) -> tuple[list[float], bool]:
        """Return the exact optimum of G1 and G2, and whether the solver was of no help.

        The solver's active bounds are solved for and verified; failing that, the dynamic program
        needs no solver.
        """
        goal = [0.0] * len(targets)
        replaced = False
        for channel, last in enumerate((steering, speed)):
            wanted, bounds, unit = (
                targets[channel::2],
                self._channels[channel],
                self._units[channel],
            )
            if guess is not None:
                chain = settle_chain(guess[channel::2], wanted, bounds, last, _ACTIVE * unit)
                if is_optimal(chain, wanted, bounds, last, _CERTIFIED * unit):
                    goal[channel::2] = chain
                    continue
            goal[channel::2] = solve_chain(wanted, bounds, last)
            replaced = True
        return goal, replaced

    def _bend(
        self,
        start: list[float],
        targets: Array,
        steering: float,
        speed: float,
        stop_at: float,
        reason: str,
    ) -> tuple[list[float], Status, str]:
        """Improve a repaired horizon where the lateral bound binds."""
        assert self._successive is not None
        answer = self._successive.solve(targets, np.array(start), (steering, speed), stop_at)
        reason = reason or answer.reason
        if answer.horizon is None:
            return start, Status.FALLBACK, reason
        goal = answer.horizon.tolist()
        commands = repair(self._bounds, goal, steering, speed, self.weights).commands
        cost, first_cost = self._cost(commands, targets), self._cost(start, targets)
        if cost > first_cost:
            commands = start
            if cost > first_cost * (1.0 + self.tolerance):
                return start, Status.REPAIRED, reason or "the repair alone was nearer"
        moved = self._distance(goal, commands)
        if not reason and moved > self.tolerance:
            reason = f"the answer was repaired by {moved:.1e} steps"
        return commands, Status.REPAIRED if reason else Status.PROJECTED, reason

    def _cost(self, commands: list[float], targets: Array) -> float:
        """Return the objective of a flat horizon."""
        difference = np.array(commands) - targets
        return float(0.5 * np.dot(self._diagonal, difference * difference))

    def _distance(self, first: list[float], second: list[float]) -> float:
        """Return the largest difference of two flat horizons in units of a step."""
        turn, change = self._units
        return max(
            max(abs(a - b) for a, b in zip(first[::2], second[::2], strict=True)) / turn,
            max(abs(a - b) for a, b in zip(first[1::2], second[1::2], strict=True)) / change,
        )

    def _set_previous(self, steering: float, speed: float) -> None:
        """Write the first rate rows; an inadmissible previous command keeps them feasible."""
        bounds, row = self._bounds, 2 * self.horizon
        side, step = bounds.max_steering, bounds.steering_step
        turn, change = self._units
        self._lower[row] = min(steering - step, side) / turn
        self._upper[row] = max(steering + step, -side) / turn
        self._lower[row + 1] = min(speed - bounds.fall, bounds.max_speed) / change
        self._upper[row + 1] = max(speed + bounds.rise, bounds.min_speed) / change


def _checked_arguments(
    horizon: Any, weights: Any, tolerance: Any, deadline: Any
) -> tuple[int, tuple[float, float]]:
    """Refuse arguments of a projector that make no sense.

    Returns:
        The horizon and the weights as plain numbers.

    Raises:
        InvalidProblem: Naming the argument and its value.
    """
    if isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)) or horizon < 1:
        raise InvalidProblem(f"`horizon` must be a positive integer. Got {reprlib.repr(horizon)}.")
    pair = as_array("weights", weights)
    if pair.shape != (2,) or not ((pair >= 1e-9) & (pair <= 1e9)).all():
        raise InvalidProblem(
            f"`weights` must be two numbers in [1e-9, 1e9]. Got {reprlib.repr(weights)}."
        )
    check_positive(InvalidProblem, tolerance=tolerance, deadline=deadline)
    return int(horizon), (float(pair[0]), float(pair[1]))
