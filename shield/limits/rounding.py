r"""Floating-point predicates that never call admissible what exact arithmetic does not.

A rounded comparison such as ``abs(u - p) <= step`` can answer *yes* while the exact difference of
the two float64 numbers is larger than ``step``. The functions here decide the exact question, at
the price of a few additions:

* ``fl(a - b) < step`` implies ``a - b <= step`` and ``fl(a - b) > step`` implies ``a - b > step``,
  because rounding is monotone and ``step`` is itself a float64. Only a tie needs the rounding
  error, which Knuth's TwoSum yields exactly.
* the lateral acceleration is computed with a relative error below `BAND`. What is inside that band
  below the bound counts as outside, so that nothing is called admissible that is not.

References:
    D. Knuth, The Art of Computer Programming, vol. 2, section 4.2.2, theorem B (TwoSum).
"""

import math

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "BAND",
    "difference_exceeds",
    "differences_exceed",
    "sum_above",
    "sum_below",
    "sums_below",
]

# Relative error of the float64 lateral acceleration: v * v, the product, a * L and the comparison
# are half an ulp each, tan at most 4 ulp (numpy's SIMD one); with some to spare.
BAND = 16.0 * 2.0**-52


def sum_below(a: float, b: float) -> float:
    """Return the largest float64 that is at most the exact ``a + b``."""
    total = a + b
    virtual = total - a
    if (a - (total - virtual)) + (b - virtual) < 0.0:
        return math.nextafter(total, -math.inf)
    return total


def sum_above(a: float, b: float) -> float:
    """Return the smallest float64 that is at least the exact ``a + b``."""
    total = a + b
    virtual = total - a
    if (a - (total - virtual)) + (b - virtual) > 0.0:
        return math.nextafter(total, math.inf)
    return total


def difference_exceeds(a: float, b: float, step: float) -> bool:
    """Tell whether the exact ``a - b`` is larger than ``step`` (finite arguments)."""
    difference = a - b
    if difference != step:
        return difference > step
    virtual = difference - a
    return (a - (difference - virtual)) - (b + virtual) > 0.0


def sums_below(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `sum_below` elementwise; infinite where the sum is."""
    total = a + b
    with np.errstate(invalid="ignore"):
        virtual = total - a
        error = (a - (total - virtual)) + (b - virtual)
    return np.where(error < 0.0, np.nextafter(total, -np.inf), total)


def differences_exceed(
    a: NDArray[np.float64], b: NDArray[np.float64], step: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return `difference_exceeds` elementwise."""
    difference = a - b
    ties = difference == step
    result = np.asarray(difference > step)
    if ties.any():
        virtual = difference - a
        error = (a - (difference - virtual)) - (b + virtual)
        result = result | (ties & (error > 0.0))
    return result
