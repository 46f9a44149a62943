r"""Vehicle limits for an action space of two numbers, in its own precision.

The space is either normalised, [-1, 1], or physical, [rad, m/s]. The command that the environment
executes is a function of the *rounded* action. Actions are projected onto limits that are tighter
by more than the rounding errors, so that rounding a safe command leaves it safe; an action that is
admissible as it is passes bit by bit.
"""

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from shield.errors import Array, InvalidLimits, InvalidProblem, as_array
from shield.gym.box_filter import as_action, as_floating, certify
from shield.limits.actuator_limits import ActuatorLimits
from shield.projection.certificate import Certificate, Status
from shield.projection.repair import worst_excess
from shield.safety_filter import SafetyFilter

__all__ = ["VehicleFilter"]


class VehicleFilter:
    """Guards actions (steering, speed) with G1, G2 and G3 on what they make the car do.

    Args:
        limits: Limits of the vehicle.
        low: Lower bounds of the action space, shape (2,).
        high: Upper bounds of the action space, shape (2,).
        normalised: Whether actions are mapped to commands by `ActuatorLimits.to_command`.
        dtype: Precision of the action space.
        rest: Command [rad, m/s] that counts as executed after `reset`. Default: straight wheels and
            the speed nearest to standstill.

    Raises:
        InvalidProblem: The space is not one of two floating point numbers, or `rest` is not finite.
        InvalidLimits: No command lies both in the space and in the limits, or the limits are finer
            than the precision of the space.
    """

    def __init__(
        self,
        limits: ActuatorLimits,
        low: ArrayLike,
        high: ArrayLike,
        *,
        normalised: bool,
        dtype: DTypeLike = np.float32,
        rest: ArrayLike | None = None,
    ) -> None:
        self._dtype = as_floating("dtype", dtype)
        bottom, top = as_array("low", low, (2,)), as_array("high", high, (2,))
        if normalised and not ((bottom == -1.0).all() and (top == 1.0).all()):
            raise InvalidProblem(f"a normalised space must be [-1, 1]. Got {low!r} to {high!r}.")
        self._normalised = normalised
        self.limits = limits
        if not normalised:
            side = min(limits.max_steering, float(-bottom[0]), float(top[0]))
            slowest = max(limits.min_speed, float(bottom[1]))
            fastest = min(limits.max_speed, float(top[1]))
            if side <= 0.0 or slowest > fastest:
                raise InvalidLimits(f"no command lies both in {bottom} to {top} and in {limits}.")
            self.limits = replace(limits, max_steering=side, min_speed=slowest, max_speed=fastest)
        self._filter = SafetyFilter(self._tightened())
        start = np.clip(np.zeros(2), self.limits.low, self.limits.high)
        self._rest = start if rest is None else as_array("rest", rest, (2,)).copy()
        if not np.isfinite(self._rest).all():
            raise InvalidProblem(f"`rest` must be finite. Got {rest!r}.")
        self.reset()

    @property
    def previous(self) -> Array:
        """The last executed command [rad, m/s], shape (2,), read-only."""
        return self._filter.previous

    def reset(self, command: ArrayLike | None = None) -> None:
        """Count a command (2,) as executed, cut to the limits; the rest command by default."""
        start = self._rest
        if command is not None:
            start = np.clip(as_array("command", command, (2,)), self.limits.low, self.limits.high)
        self._action = self.to_action(start)
        self._filter.reset(self.to_command(self._action))

    @np.errstate(all="ignore")
    def filter(self, action: ArrayLike) -> Certificate:
        """Return the action to execute, and remember it as executed.

        Args:
            action: Nominal action, shape (2,), any values.

        Returns:
            The certificate, in the units and the precision of the action space.

        Raises:
            InvalidProblem: The shape does not fit.
        """
        begin = time.perf_counter()
        nominal = as_action("action", action, (2,))
        given = nominal.astype(self._dtype)
        before, command = self.previous, self.to_command(given)
        status, reason, excess = Status.NOMINAL, "", 0.0
        if self.limits.violated(command, before):
            certificate = self._filter.filter(command)
            status, reason = certificate.status, certificate.reason
            # What only the tightened limits ask for is still a change of the action.
            status = Status.PROJECTED if status is Status.NOMINAL else status
            given = self.to_action(certificate.safe_action)
            command = self.to_command(given)
            if self.limits.violated(command, before) and not certificate.max_violation:
                status, reason = Status.REPAIRED, "the last action is held"
                given, command = self._action, before.copy()
            excess = worst_excess(self.limits, command.tolist(), *before.tolist())
        self._filter.record(command)
        self._action = given
        return certify(nominal, given, status, reason, excess, begin)

    def _tightened(self) -> ActuatorLimits:
        """Return limits that still hold after a command was rounded to the space's precision."""
        limits = self.limits
        low, high = limits.low, limits.high
        # A unit in the last place of the largest action, as a command; rounding errs by half of it.
        size = high - low if self._normalised else np.maximum(np.abs(low), np.abs(high))
        margin = np.where(high > low, size * float(np.finfo(self._dtype).eps), 0.0)
        turn, change = margin.tolist()
        steps = np.minimum(limits.max_increase, limits.max_decrease)
        if (2.0 * margin >= np.minimum(steps, np.where(high > low, high - low, np.inf))).any():
            raise InvalidLimits(f"{self._dtype} is too coarse for the steps {steps} of {limits}.")
        lateral = limits.max_lateral_acceleration
        if lateral is not None:
            # The largest change of v² tan δ along the bound: in v at most that at full steering, in
            # δ at most that at full speed.
            bound, tangent = lateral * limits.wheelbase, math.tan(limits.max_steering)
            fastest = max(abs(limits.min_speed), abs(limits.max_speed))
            lost = 2.0 * math.sqrt(bound * tangent) * change
            lost += (fastest * fastest + bound * tangent) * turn
            if lost >= 0.5 * bound:
                raise InvalidLimits(
                    f"{self._dtype} is too coarse for `max_lateral_acceleration`. Got {lateral!r}."
                )
            lateral -= 2.0 * lost / limits.wheelbase
        return replace(
            limits,
            max_steering=limits.max_steering - turn,
            min_speed=limits.min_speed + change,
            max_speed=limits.max_speed - change,
            max_steering_rate=limits.max_steering_rate - turn / limits.dt,
            max_acceleration=limits.max_acceleration - change / limits.dt,
            max_deceleration=limits.max_deceleration - change / limits.dt,
            max_lateral_acceleration=lateral,
        )

    def to_command(self, action: NDArray[Any]) -> Array:
        """Return the command (2,) [rad, m/s] of an action (2,)."""
        exact = action.astype(np.float64)
        return self.limits.to_command(exact) if self._normalised else exact

    def to_action(self, command: Array) -> NDArray[Any]:
        """Return the nearest action (2,) that the space's precision can express."""
        exact = self.limits.to_action(command) if self._normalised else command
        with np.errstate(over="ignore"):
            return exact.astype(self._dtype)
