r"""Vehicle limits for an action space of two numbers, in its own precision.

The space is either normalised, ``Box(-1, 1)``, or physical, [rad, m/s]. The command that the
environment executes is a function of the *rounded* action, so a safe command is of no use until an
action has been found whose own command is safe. Near the projected command there are a few
neighbouring actions on the grid of the space; the nearest one that passes the exact check is
taken, and the last executed action, which is on the grid and admissible, if none does.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from shield.arguments import as_array
from shield.errors import InvalidLimits, InvalidProblem
from shield.gym.box_filter import as_action, as_floating
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.rounding import differences_exceed, lateral_exceeds
from shield.projection.certificate import Certificate, Status
from shield.projection.repair import Bounds, boundary_speed
from shield.safety_filter import SafetyFilter

__all__ = ["VehicleFilter"]

Array = NDArray[np.float64]

# Grid steps from the rounded action that are tried: a command may be much coarser than its action.
_REACH = np.array([0, -1, 1, -2, 2, -4, 4, -8, 8, -16, 16, -32, 32])


class _Candidate(NamedTuple):
    """A value of one channel, as the space holds it and as the vehicle executes it."""

    action: Any
    command: float


class VehicleFilter:
    """Guards actions (steering, speed) with G1, G2 and G3 on what they make the car do.

    Args:
        limits: Limits of the vehicle.
        low: Lower bounds of the action space, shape (2,).
        high: Upper bounds of the action space, shape (2,).
        dtype: Precision of the action space. Default: float32.
        normalised: True: actions are mapped to commands by `ActuatorLimits.to_command`. False:
            actions are commands. None: decided by whether the space is [-1, 1].
        rest: Command [rad, m/s] that counts as executed after `reset`. Default: straight wheels and
            the speed nearest to standstill.

    Raises:
        InvalidProblem: The space is not one of two floating point numbers, or `rest` is not finite.
        InvalidLimits: No command lies both in the space and in the limits.
    """

    def __init__(
        self,
        limits: ActuatorLimits,
        low: ArrayLike,
        high: ArrayLike,
        *,
        dtype: DTypeLike = np.float32,
        normalised: bool | None = None,
        rest: ArrayLike | None = None,
    ) -> None:
        self._dtype = as_floating("dtype", dtype)
        bottom, top = as_array("low", low, (2,)), as_array("high", high, (2,))
        unit = bool((bottom == -1.0).all() and (top == 1.0).all())
        self._normalised = unit if normalised is None else normalised
        if self._normalised and not unit:
            raise InvalidProblem(f"a normalised space must be [-1, 1]. Got {low!r} to {high!r}.")
        self.limits = limits if self._normalised else _within(limits, bottom, top)
        self._filter = SafetyFilter(self.limits)
        self._bounds = Bounds.of(self.limits)
        self._low, self._high = bottom, top
        start = np.clip(np.zeros(2), self.limits.low, self.limits.high)
        self._rest = start if rest is None else as_array("rest", rest, (2,)).copy()
        if not np.isfinite(self._rest).all():
            raise InvalidProblem(f"`rest` must be finite. Got {rest!r}.")
        self.reset()

    @property
    def previous(self) -> Array:
        """The last executed command [rad, m/s], shape (2,), read-only."""
        return self._filter.previous

    def reset(self) -> None:
        """Count the rest command as executed."""
        self._action = self._round(self._to_action(self._rest))
        self._filter.reset(self._to_command(self._action))

    @np.errstate(all="ignore")
    def filter(self, action: ArrayLike) -> Certificate:
        """Return the action to execute, and remember it as executed.

        Args:
            action: Wanted action, shape (2,), any values.

        Returns:
            The certificate, in the units and the precision of the action space. An admissible
            action passes bit by bit.

        Raises:
            InvalidProblem: The shape does not fit.
        """
        wanted = as_action("action", action, (2,))
        given = self._round(wanted)
        before = self._filter.previous
        certificate = self._filter.filter(self._to_command(given))
        if certificate.intervened:
            realised = self._realise(certificate, before)
            if realised is None:
                reason = "no action near the projected one is admissible: the last one is held"
                certificate = replace(certificate, status=Status.REPAIRED, reason=reason)
            given = self._action if realised is None else realised
            self._filter.record(self._to_command(given))
        self._action = given
        correction = given.astype(np.float64) - wanted
        for array in (wanted, given, correction):
            array.flags.writeable = False
        return replace(certificate, nominal_action=wanted, safe_action=given, correction=correction)

    def _realise(self, certificate: Certificate, before: Array) -> NDArray[Any] | None:
        """Return the action on the grid nearest to a safe command that is safe itself, if any."""
        safe = certificate.safe_action
        lenient = certificate.max_violation > 0.0
        steering = self._candidates(safe, before, 0, lenient)
        speed = self._candidates(safe, before, 1, lenient)
        best = self._nearest(product(steering, speed), safe, lenient)
        if best is not None:
            return best
        # Where the lateral bound is steep, one grid step in steering is worth many in speed.
        pairs = []
        for angle in steering:
            fastest = boundary_speed(self._bounds, angle.command)
            slower = np.array([angle.command, np.clip(safe[1], -fastest, fastest)])
            values = self._candidates(slower, before, 1, lenient)
            pairs += [(angle, value) for value in values]
        return self._nearest(pairs, safe, lenient)

    def _candidates(
        self, command: Array, before: Array, channel: int, lenient: bool
    ) -> list["_Candidate"]:
        """Return values of the space near a command that keep box and rate of one channel.

        Args:
            command: Where to look [rad, m/s], shape (2,).
            before: The command executed before, shape (2,).
            channel: 0 for steering, 1 for speed.
            lenient: If none keeps the rate, return those that keep the box.
        """
        limits = self.limits
        action = self._round(self._to_action(command))
        # Near zero an action is much finer than its command, so steps of both sizes are tried.
        sizes = np.spacing(np.array([action[channel], 1.0], dtype=self._dtype))
        grid = (action[channel] + np.outer(sizes, _REACH.astype(self._dtype))).ravel()
        grid = grid[(self._low[channel] <= grid) & (grid <= self._high[channel])]
        actions = np.repeat(action[None], len(grid), axis=0)
        actions[:, channel] = grid
        values = self._to_command(actions)[:, channel]
        last = np.full(len(values), before[channel])
        boxed = (limits.low[channel] <= values) & (values <= limits.high[channel])
        steady = ~differences_exceed(values, last, np.asarray(limits.rise[channel]))
        steady &= ~differences_exceed(last, values, np.asarray(limits.fall[channel]))
        good = boxed & steady
        if lenient and not good.any():
            good = boxed
        return [
            _Candidate(value, float(exact))
            for value, exact in zip(grid[good], values[good], strict=True)
        ]

    def _nearest(
        self, pairs: Iterable[tuple["_Candidate", "_Candidate"]], safe: Array, lenient: bool
    ) -> NDArray[Any] | None:
        """Return the pair nearest to a safe command that keeps the lateral bound, if any.

        Args:
            pairs: Candidates for steering and speed.
            safe: The safe command.
            lenient: Take the nearest pair, because the safe command breaks a bound itself.
        """
        bound, wheelbase = self.limits.max_lateral_acceleration, self.limits.wheelbase
        turn, change = self.limits.rise
        ranked = sorted(
            pairs,
            key=lambda pair: (
                abs(pair[0].command - safe[0]) / turn + abs(pair[1].command - safe[1]) / change
            ),
        )
        for steering, speed in ranked:
            if (
                lenient
                or bound is None
                or not lateral_exceeds(steering.command, speed.command, bound, wheelbase)
            ):
                return np.array([steering.action, speed.action], dtype=self._dtype)
        return None

    def _round(self, action: NDArray[Any]) -> NDArray[Any]:
        with np.errstate(over="ignore"):
            return action.astype(self._dtype)

    def _to_command(self, action: NDArray[Any]) -> Array:
        exact = action.astype(np.float64)
        return self.limits.to_command(exact) if self._normalised else exact

    def _to_action(self, command: Array) -> Array:
        return self.limits.to_action(command) if self._normalised else command


def _within(limits: ActuatorLimits, low: Array, high: Array) -> ActuatorLimits:
    """Return the limits cut down to an action space in physical units."""
    side = min(limits.max_steering, float(-low[0]), float(high[0]))
    slowest = max(limits.min_speed, float(low[1]))
    fastest = min(limits.max_speed, float(high[1]))
    if side <= 0.0 or slowest > fastest:
        raise InvalidLimits(f"no command lies in both the space {low} to {high} and {limits}.")
    return replace(limits, max_steering=side, min_speed=slowest, max_speed=fastest)
