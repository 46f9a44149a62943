"""Checks of what callers hand in: types and shapes raise, values never do."""

import math
import reprlib
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.errors import InvalidProblem

__all__ = ["as_array", "as_float", "as_horizon", "check_positive", "check_within", "is_number"]

Array = NDArray[np.float64]


def as_array(name: str, values: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """Return `values` as float64, the same object if it already is; do not write to it.

    Numbers too large for float64 become infinite.

    Raises:
        InvalidProblem: They are not real numbers, ragged, or not of `shape`.
    """
    array = values if type(values) is np.ndarray and values.dtype == np.float64 else None
    if array is None:
        array = _convert(name, values)
    if shape is not None and array.shape != shape:
        raise InvalidProblem(f"`{name}` must have shape {shape}. Got {array.shape}.")
    return array


def as_horizon(name: str, values: ArrayLike) -> Array:
    """Return `values` as float64 of shape (H, 2), H > 0.

    Raises:
        InvalidProblem: As `as_array`.
    """
    array = as_array(name, values)
    if array.ndim != 2 or array.shape[1] != 2 or not array.size:
        raise InvalidProblem(f"`{name}` must have shape (H, 2), H > 0. Got {array.shape}.")
    return array


def is_number(value: object) -> TypeGuard[float]:
    """Tell whether `value` is one real number, of Python or of numpy; truth values are not."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def as_float(value: object) -> float:
    """Return one number as float64; integers beyond it become infinite.

    Raises:
        TypeError: It is not a real number.
    """
    if not isinstance(value, (int, float, np.number)):
        raise TypeError(value)
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def check_positive(error: type[Exception], **values: Any) -> None:
    """Refuse arguments that are not positive, finite numbers.

    Args:
        error: What to raise.
        **values: Arguments by name.
    """
    for name, value in values.items():
        if not is_number(value) or not 0.0 < as_float(value) < math.inf:
            raise error(f"`{name}` must be positive and finite. Got {reprlib.repr(value)}.")


def check_within(error: type[Exception], low: float, high: float, **values: Any) -> None:
    """Refuse arguments that are not finite numbers in [`low`, `high`]; a bound may be infinite.

    Args:
        error: What to raise.
        low: Smallest admissible value.
        high: Largest admissible value.
        **values: Arguments by name.
    """
    for name, value in values.items():
        if is_number(value) and math.isfinite(as_float(value)) and low <= as_float(value) <= high:
            continue
        rule = f"lie in [{low:g}, {high:g}]"
        if high == math.inf:
            rule = "be finite" if low == -math.inf else f"be finite and at least {low:g}"
        raise error(f"`{name}` must {rule}. Got {reprlib.repr(value)}.")


def _convert(name: str, values: ArrayLike) -> Array:
    try:
        array = np.asarray(values)
        if array.dtype.kind == "O":
            array = np.vectorize(as_float, otypes=[np.float64])(array)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InvalidProblem(f"`{name}` must hold real numbers. Got {_brief(values)}.") from error
    if array.dtype.kind not in "fiub":
        raise InvalidProblem(f"`{name}` must hold real numbers. Got dtype {array.dtype}.")
    with np.errstate(all="ignore"):
        return array.astype(np.float64)


def _brief(values: object) -> str:
    """Return a short form of `values` on one line."""
    return " ".join(reprlib.repr(values).split())
