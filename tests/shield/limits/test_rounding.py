"""The floating-point predicates answer as exact arithmetic does."""

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import strategies as st

from shield.limits.rounding import (
    BAND,
    difference_exceeds,
    differences_exceed,
    lateral_exceeds,
    sum_above,
    sum_below,
    sums_below,
)
from tests.shield.tiers import two_tiers

ORDINARY = st.floats(-1e6, 1e6) | st.sampled_from([0.0, 5e-324, -5e-324, 1e-310, 0.1, 1e16])


@two_tiers(a=ORDINARY, b=ORDINARY)
def test_sum_below_is_the_largest_float_below_the_exact_sum(a: float, b: float) -> None:
    """No float64 lies between `sum_below` and the exact sum; `sum_above` mirrors it."""
    exact = Fraction(a) + Fraction(b)
    below, above = sum_below(a, b), sum_above(a, b)
    assert Fraction(below) <= exact < Fraction(math.nextafter(below, math.inf))
    assert Fraction(math.nextafter(above, -math.inf)) < exact <= Fraction(above)
    assert sums_below(np.array([a]), np.array([b])).tolist() == [below]


@two_tiers(a=ORDINARY, b=ORDINARY, step=ORDINARY, ulps=st.integers(-2, 2))
def test_difference_exceeds_decides_the_exact_question(
    a: float, b: float, step: float, ulps: int
) -> None:
    """Also where the rounded difference ties with the step or misses it by an ulp."""
    near = a - b
    for _ in range(abs(ulps)):
        near = math.nextafter(near, math.copysign(math.inf, ulps))
    for bound in (step, near):
        exact = Fraction(a) - Fraction(b) > Fraction(bound)
        assert difference_exceeds(a, b, bound) == exact
        arrays = (np.array([a]), np.array([b]), np.array([bound]))
        assert differences_exceed(*arrays).tolist() == [exact]


@pytest.mark.parametrize("ulps", range(-40, 41, 4))
def test_lateral_exceeds_decides_inside_the_undecided_band(ulps: int) -> None:
    """A speed some ulps from the boundary is judged as 50-digit arithmetic judges it."""
    steering, acceleration, wheelbase = 0.3, 4.0, 2.7
    speed = math.sqrt(acceleration * wheelbase / math.tan(steering)) * (1.0 + ulps * 2.0**-52)
    with mpmath.workdps(50):
        exact = mpmath.mpf(speed) ** 2 * mpmath.tan(mpmath.mpf(steering))
        expected = bool(exact / mpmath.mpf(wheelbase) > acceleration)
    assert lateral_exceeds(steering, speed, acceleration, wheelbase) == expected
    assert lateral_exceeds(-steering, -speed, acceleration, wheelbase) == expected


def test_the_band_is_needed() -> None:
    """Without exact arithmetic the float64 comparison gets commands on the boundary wrong."""
    rng = np.random.default_rng(0)
    wrong = 0
    for _ in range(2000):
        steering = rng.uniform(0.01, 1.2)
        speed = math.sqrt(10.8 / math.tan(steering)) * (1.0 + rng.integers(-2, 3) * 2.0**-53)
        naive = speed * speed * math.tan(steering) / 2.7 > 4.0
        wrong += naive != lateral_exceeds(steering, speed, 4.0, 2.7)
    assert wrong > 0
    assert BAND < 1e-14
