r"""Box and rate bounds for any action space, in its own units and its own precision.

Without a coupling between dimensions the nearest admissible action is a clip, dimension by
dimension. What takes care is the precision: in a float32 space the result is the nearest float32
*inside* the window, whose ends are those of exact arithmetic. The last executed action is a float32
inside its own window, so there always is one.
"""

import time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from shield.errors import Array, InvalidLimits, InvalidProblem, as_array, check_positive
from shield.limits.rounding import differences_exceed, sums_below
from shield.projection.certificate import Certificate, Status

__all__ = ["BoxFilter", "as_action", "as_floating", "certify"]


class BoxFilter:
    """Keeps actions in a box and within a step of the last executed one.

    Args:
        low: Lower bounds, shape (n,) or any other; infinite where there is none.
        high: Upper bounds, same shape.
        rate: Largest rates of change per second, one number or an array like `low`; infinite where
            there is none. The step is the float64 product ``rate * dt``.
        dt: Control period [s]. Default: 1, so that rates are per step.
        dtype: Precision of the actions.
        rest: Action that counts as executed after `reset`, and that an unusable action is answered
            by moving to. Default: the point of the box nearest to zero.

    Raises:
        InvalidLimits: Bounds that no action satisfies, rates that are not positive.
        InvalidProblem: `dtype` is not a floating point type, or `rest` does not fit.
    """

    def __init__(
        self,
        low: ArrayLike,
        high: ArrayLike,
        rate: ArrayLike = np.inf,
        dt: float = 1.0,
        *,
        dtype: DTypeLike = np.float32,
        rest: ArrayLike | None = None,
    ) -> None:
        self._dtype = as_floating("dtype", dtype)
        self._low, self._high = as_array("low", low), as_array("high", high)
        shape = self._low.shape
        if shape != self._high.shape or not (self._low <= self._high).all():
            raise InvalidLimits(f"`low` must not exceed `high`. Got {low!r} and {high!r}.")
        check_positive(InvalidLimits, dt=dt)
        rates = as_array("rate", rate)
        if rates.shape not in {(), shape}:
            raise InvalidLimits(f"`rate` must have shape {shape} or (). Got {rates.shape}.")
        with np.errstate(over="ignore", under="ignore"):
            self._step = np.broadcast_to(rates, shape) * dt
        if not (self._step > 0.0).all():
            raise InvalidLimits(f"`rate` times `dt` must be positive. Got {rate!r} times {dt!r}.")
        # The box of the representable, finite actions.
        largest = float(np.finfo(self._dtype).max)
        self._low = np.maximum(-self._round_down(-self._low), -largest)
        self._high = np.minimum(self._round_down(self._high), largest)
        if not (self._low <= self._high).all():
            raise InvalidLimits(f"no {self._dtype} lies between {low!r} and {high!r}.")
        start = np.zeros(shape) if rest is None else as_array("rest", rest)
        if start.shape != shape or not np.isfinite(start).all():
            raise InvalidProblem(f"`rest` must be finite and have shape {shape}. Got {rest!r}.")
        rounded = start.astype(self._dtype).astype(np.float64)
        self._rest = np.asarray(np.clip(rounded, self._low, self._high))
        self.reset()

    @property
    def previous(self) -> Array:
        """The last executed action as float64, read-only."""
        return self._previous

    def reset(self) -> None:
        """Count the rest action as executed."""
        self._execute(self._rest.copy())

    @np.errstate(all="ignore")
    def filter(self, action: ArrayLike) -> Certificate:
        """Return the nearest admissible action, and remember it as executed.

        Args:
            action: Nominal action, shape as `low`, any values.

        Returns:
            The certificate. `safe_action` has the precision of the space; an admissible action is
            in it bit by bit. An action that is not finite is answered by moving to the rest action
            at full rate.

        Raises:
            InvalidProblem: The shape does not fit.
        """
        begin = time.perf_counter()
        nominal = as_action("action", action, self._low.shape)
        cast = nominal.astype(self._dtype)
        value = cast.astype(np.float64)
        status, reason = Status.NOMINAL, ""
        if not self._is_admissible(value):
            finite = bool(np.isfinite(nominal).all())
            status = Status.PROJECTED if finite else Status.FALLBACK
            reason = "" if finite else f"action {nominal.tolist()} is not finite: moving to rest"
            value = np.asarray(self._into_window(value if finite else self._rest))
            cast = value.astype(self._dtype)
        excess = 0.0 if self._is_admissible(value) else np.inf
        self._execute(value)
        return certify(nominal, cast, status, reason, excess, begin)

    def _is_admissible(self, value: Array) -> bool:
        """Tell whether an action keeps box and rates exactly."""
        good = (self._low <= value) & (value <= self._high)
        good &= ~differences_exceed(value, self._previous, self._step)
        good &= ~differences_exceed(self._previous, value, self._step)
        return bool(good.all())

    def _into_window(self, value: Array) -> Array:
        """Return the nearest representable action of box and rate window."""
        top = np.minimum(self._round_down(sums_below(self._previous, self._step)), self._high)
        bottom = np.maximum(-self._round_down(sums_below(-self._previous, self._step)), self._low)
        return np.clip(value, bottom, top)

    def _round_down(self, value: Array) -> Array:
        """Return the largest representable number that is at most `value`."""
        with np.errstate(over="ignore"):
            cast: NDArray[Any] = np.asarray(value.astype(self._dtype))
        lower = np.nextafter(cast, np.asarray(-np.inf, dtype=self._dtype))
        return np.where(cast > value, lower, cast).astype(np.float64)

    def _execute(self, value: Array) -> None:
        value.flags.writeable = False
        self._previous = value


def as_action(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return a copy of real numbers of `shape` in their own precision."""
    numbers = as_array(name, values, shape)
    own = getattr(values, "dtype", None)
    # What is not an array of numbers already, such as a list of huge integers, is float64.
    kept = isinstance(own, np.dtype) and own.kind in "fiub"
    return np.array(values) if kept else numbers.copy()


def as_floating(name: str, dtype: DTypeLike) -> np.dtype[Any]:
    """Return a floating point type."""
    try:
        kind = np.dtype(dtype)
    except TypeError as error:
        raise InvalidProblem(f"`{name}` must be a floating point type. Got {dtype!r}.") from error
    if kind.kind != "f":
        raise InvalidProblem(f"`{name}` must be a floating point type. Got {kind}.")
    return kind


def certify(
    nominal: NDArray[Any],
    safe: NDArray[Any],
    status: Status,
    reason: str,
    excess: float,
    begin: float,
) -> Certificate:
    """Return the certificate of a call that began at `begin`; its arrays become read-only."""
    # Of a space without dimensions numpy makes scalars, which are read-only anyway.
    correction = np.asarray(safe.astype(np.float64) - nominal)
    for array in (nominal, safe, correction):
        array.flags.writeable = False
    return Certificate(
        nominal_action=nominal,
        safe_action=safe,
        status=status,
        reason=reason,
        correction=correction,
        max_violation=excess,
        solve_time=time.perf_counter() - begin,
        intervened=status is not Status.NOMINAL,
    )
