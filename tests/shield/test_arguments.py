"""The shared checks of arguments refuse by name and show the value."""

import math

import pytest

from shield.errors import check_within


@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan, math.inf, "1", None, True])
def test_check_within_refuses_by_name(value: object) -> None:
    """Outside the interval, not finite or not a number: the message says which and what."""
    with pytest.raises(ValueError, match=r"`share` must lie in \[0, 1\]\. Got"):
        check_within(ValueError, 0.0, 1.0, share=value)


def test_check_within_allows_infinite_bounds() -> None:
    """An infinite bound leaves that side open, but the value stays finite."""
    check_within(ValueError, 0.0, math.inf, gain=0.0, loss=1e300)
    check_within(ValueError, -math.inf, math.inf, weight=-3)
    with pytest.raises(ValueError, match="`gain` must be finite and at least 0"):
        check_within(ValueError, 0.0, math.inf, gain=math.inf)
    with pytest.raises(ValueError, match="`weight` must be finite"):
        check_within(ValueError, -math.inf, math.inf, weight=math.nan)
