"""Checks of what callers hand in: types and shapes raise, values never do."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.errors import InvalidProblem
from shield.limits import ActuatorLimits

__all__ = ["as_array", "as_horizon", "check_projector_arguments"]

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


def _convert(name: str, values: ArrayLike) -> Array:
    try:
        array = np.asarray(values)
        if array.dtype.kind == "O":
            array = np.vectorize(_as_float, otypes=[np.float64])(array)
    except (TypeError, ValueError) as error:
        raise InvalidProblem(f"`{name}` must hold real numbers. Got {values!r}.") from error
    if array.dtype.kind not in "fiub":
        raise InvalidProblem(f"`{name}` must hold real numbers. Got dtype {array.dtype}.")
    with np.errstate(over="ignore"):
        return array.astype(np.float64)


def _as_float(value: object) -> float:
    """Return one number; integers beyond float64 become infinite."""
    if not isinstance(value, (int, float, np.number)):
        raise TypeError(value)
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def check_projector_arguments(
    limits: ActuatorLimits,
    horizon: int,
    weights: tuple[float, float],
    tolerance: float,
    deadline: float,
) -> None:
    """Refuse arguments of a projector that make no sense.

    Raises:
        InvalidProblem: Naming the argument and its value.
    """
    if not isinstance(limits, ActuatorLimits):
        raise InvalidProblem(f"`limits` must be ActuatorLimits. Got {limits!r}.")
    if isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)) or horizon < 1:
        raise InvalidProblem(f"`horizon` must be a positive integer. Got {horizon!r}.")
    if np.shape(weights) != (2,) or not all(1e-9 <= weight <= 1e9 for weight in weights):
        raise InvalidProblem(f"`weights` must be two numbers in [1e-9, 1e9]. Got {weights!r}.")
    for name, value in (("tolerance", tolerance), ("deadline", deadline)):
        if not _is_number(value) or not 0.0 < value < math.inf:
            raise InvalidProblem(f"`{name}` must be positive and finite. Got {value!r}.")


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
