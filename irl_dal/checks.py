"""Admissible values of a configuration's fields."""

from collections.abc import Mapping
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from shield.errors import check_within

# Smallest and largest value of each field; a pair of integers asks for an integer
Ranges = Mapping[str, tuple[float, float]]


def check_ranges(config: Any, ranges: Ranges) -> None:
    """Refuse fields that are not finite numbers in their range; `ValueError` names field, value."""
    for name, (low, high) in ranges.items():
        value = getattr(config, name)
        check_within(ValueError, low, high, **{name: value})
        if isinstance(low, int) and not isinstance(value, (int, np.integer)):
            raise ValueError(f"`{name}` must be an integer. Got {value!r}.")


def check_choices(config: Any) -> None:
    """Refuse `Literal` fields with another value; `ValueError` names the field and its value."""
    for name, hint in get_type_hints(type(config)).items():
        value, known = getattr(config, name), get_args(hint)
        if get_origin(hint) is Literal and value not in known:
            raise ValueError(f"`{name}` must be one of {known}. Got {value!r}.")


def nested(name: str, kind: type[Any], value: Any, error: type[Exception]) -> Any:
    """`value`, or what a mapping of its fields stands for; else `error`."""
    if isinstance(value, Mapping):
        return kind(**value)
    if not isinstance(value, kind):
        raise error(f"`{name}` must be a {kind.__name__} or a mapping. Got {value!r}.")
    return value
