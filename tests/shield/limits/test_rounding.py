"""The floating-point predicates answer as exact arithmetic does."""

import math
from fractions import Fraction

import numpy as np
from hypothesis import strategies as st

from shield import ActuatorLimits
from shield.limits.rounding import (
    BAND,
    difference_exceeds,
    differences_exceed,
    sum_above,
    sum_below,
    sums_below,
)
from tests.shield.oracles import exceeds_lateral
from tests.shield.tiers import two_tiers

FAST = ActuatorLimits(max_speed=40.0)
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


def test_what_is_called_admissible_keeps_the_lateral_bound_in_exact_arithmetic() -> None:
    """Commands some ulps around the bound, where the plain float64 comparison gets some wrong."""
    rng = np.random.default_rng(0)
    wrong = 0
    for _ in range(2000):
        steering, ulps = rng.uniform(0.01, 0.5), int(rng.integers(-40, 41))
        speed = math.sqrt(10.8 / math.tan(steering)) * (1.0 + ulps * 2.0**-53)
        command, exact = [steering, speed], exceeds_lateral(FAST, steering, speed)
        wrong += (speed * speed * math.tan(steering) / 2.7 > 4.0) != exact
        assert not exact or FAST.violated(command, command)
        if ulps < -2.0 * BAND * 2.0**53:
            assert not FAST.violated(command, command)
    assert wrong > 0
    assert BAND < 1e-14
