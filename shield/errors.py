# ruff: noqa: N818 -- the names say what is invalid, and are part of the public interface
"""Exceptions of the package, and the checks of arguments that raise them.

Only mistakes made at design time raise: impossible limits, wrong shapes, unknown solvers. Bad
*values* inside the control loop never do; they are answered with a status and a fallback.
"""

import math
import reprlib
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "InvalidLimits",
    "InvalidProblem",
    "MissingDependency",
    "ShieldError",
    "as_array",
    "as_float",
    "as_horizon",
    "check_numbers",
    "check_positive",
    "check_within",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class ShieldError(Exception):
    """Base of every exception raised by `shield`."""


class InvalidLimits(ShieldError, ValueError):
    """A bound that no command can satisfy, or that is not a number."""


class InvalidProblem(ShieldError, ValueError):
    """An argument whose shape, type or name does not fit the problem."""


class MissingDependency(ShieldError, ImportError):
    """An optional package is not installed; the message is the pip line that brings it."""


def as_array(name: str, values: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """Return `values` as float64, the same object if it already is; do not write to it.

    Numbers too large for float64 become infinite.

    Raises:
        InvalidProblem: They are not real numbers, ragged, or not of `shape`.
    """
    array = values if type(values) is np.ndarray and values.dtype == np.float64 else None
    array = _convert(name, values) if array is None else array
    if shape is not None and array.shape != shape:
        raise InvalidProblem(f"`{name}` must have shape {shape}. Got {array.shape}.")
    return array


def as_horizon(name: str, values: ArrayLike) -> Array:
    """Return `values` as float64 of shape (H, 2), H > 0; raise as `as_array`."""
    array = as_array(name, values)
    if array.ndim != 2 or array.shape[1] != 2 or not array.size:
        raise InvalidProblem(f"`{name}` must have shape (H, 2), H > 0. Got {array.shape}.")
    return array


def _is_number(value: object) -> TypeGuard[float]:
    """Tell whether `value` is one real number, of Python or of numpy; truth values are not."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def as_float(value: object) -> float:
    """Return one real number as float64, integers beyond it as infinite; else raise TypeError."""
    if not isinstance(value, (int, float, np.number)):
        raise TypeError(value)
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def check_numbers(**values: Any) -> None:
    """Refuse arguments, by name, that are not one real number each; any value will do."""
    for name, value in values.items():
        if not _is_number(value):
            raise InvalidProblem(f"`{name}` must be a number. Got {reprlib.repr(value)}.")


def check_positive(error: type[Exception], **values: Any) -> None:
    """Refuse arguments, by name, that are not positive, finite numbers; raise `error`."""
    for name, value in values.items():
        if not _is_number(value) or not 0.0 < as_float(value) < math.inf:
            raise error(f"`{name}` must be positive and finite. Got {reprlib.repr(value)}.")


def check_within(error: type[Exception], low: float, high: float, **values: Any) -> None:
    """Refuse arguments, by name, that are not finite numbers in [`low`, `high`]; raise `error`.

    Either bound may be infinite.
    """
    for name, value in values.items():
        if _is_number(value) and math.isfinite(as_float(value)) and low <= as_float(value) <= high:
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
        brief = " ".join(reprlib.repr(values).split())
        raise InvalidProblem(f"`{name}` must hold real numbers. Got {brief}.") from error
    if array.dtype.kind not in "fiub":
        raise InvalidProblem(f"`{name}` must hold real numbers. Got dtype {array.dtype}.")
    with np.errstate(all="ignore"):
        return array.astype(np.float64)
