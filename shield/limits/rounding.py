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


# Elementwise; a sum is infinite where it overflows.
sums_below = np.vectorize(sum_below, otypes=[np.float64])
differences_exceed = np.vectorize(difference_exceeds, otypes=[np.bool_])
