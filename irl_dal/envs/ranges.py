"""Admissible values of a configuration's numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from shield.errors import check_within

# Smallest and largest value of each field; a pair of integers asks for an integer
Ranges = Mapping[str, tuple[float, float]]


def check_ranges(config: Any, ranges: Ranges) -> None:
    """Refuse fields that are not finite numbers in their range.

    Raises:
        ValueError: Naming the field and its value.
    """
    for name, (low, high) in ranges.items():
        value = getattr(config, name)
        check_within(ValueError, low, high, **{name: value})
        if isinstance(low, int) and not isinstance(value, (int, np.integer)):
            raise ValueError(f"`{name}` must be an integer. Got {value!r}.")
