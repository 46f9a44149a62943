r"""Floating-point predicates whose answers are those of exact arithmetic.

A rounded comparison such as ``abs(u - p) <= step`` can answer *yes* while the exact difference of
the two float64 numbers is larger than ``step``. The functions here decide the exact question, at
the price of a few additions:

* ``fl(a - b) < step`` implies ``a - b <= step`` and ``fl(a - b) > step`` implies ``a - b > step``,
  because rounding is monotone and ``step`` is itself a float64. Only a tie needs the rounding
  error, which Knuth's TwoSum yields exactly.
* the lateral acceleration is computed with a relative error below 16 ulp. Only values inside that
  band go to 80-digit decimal arithmetic.

References:
    D. Knuth, The Art of Computer Programming, vol. 2, section 4.2.2, theorem B (TwoSum).
    J. Shewchuk, Adaptive Precision Floating-Point Arithmetic, 1997 (filtered predicates).
"""

import math
from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "BAND",
    "difference_exceeds",
    "differences_exceed",
    "lateral_exceeds",
    "sum_above",
    "sum_below",
    "sums_below",
]

# Relative half width of the band in which the float64 lateral acceleration does not decide: v * v,
# the product, a * L and the comparison are half an ulp each, tan at most 4 ulp (numpy's SIMD one).
BAND = 16.0 * 2.0**-52
_DIGITS = 80


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


def lateral_exceeds(steering: float, speed: float, acceleration: float, wheelbase: float) -> bool:
    r"""Tell whether ``speed² · |tan(steering)| / wheelbase > acceleration`` for these float64.

    Args:
        steering: Steering angle [rad], inside (-π/2, π/2).
        speed: Speed [m/s], finite, below 1e100 in size.
        acceleration: Bound [m/s²], positive.
        wheelbase: Wheelbase [m], positive.
    """
    value = speed * speed * abs(math.tan(steering))
    bound = acceleration * wheelbase
    if value <= bound * (1.0 - BAND):
        return False
    if value > bound * (1.0 + BAND):
        return True
    return _lateral_exceeds_exactly(steering, speed, acceleration, wheelbase)


def _lateral_exceeds_exactly(
    steering: float, speed: float, acceleration: float, wheelbase: float
) -> bool:
    """Decide ``v² sin|δ| > a L cos δ`` in 80-digit decimal arithmetic.

    The sine of a non-zero rational is transcendental, so the two sides are never equal.
    """
    with localcontext() as context:
        context.prec = _DIGITS
        angle = abs(Decimal(steering))
        sine = _alternating_series(angle, angle, 1)
        cosine = _alternating_series(Decimal(1), angle, 0)
        bound = Decimal(acceleration) * Decimal(wheelbase)
        return Decimal(speed) * Decimal(speed) * sine > bound * cosine


def _alternating_series(first: Decimal, angle: Decimal, order: int) -> Decimal:
    """Sum the Taylor series that starts with `first` and continues by ``-angle²/(k+1)(k+2)``."""
    total, term = first, first
    while abs(term) > Decimal(10) ** (-_DIGITS - 5):
        term = -term * angle * angle / ((order + 1) * (order + 2))
        order += 2
        total += term
    return total
