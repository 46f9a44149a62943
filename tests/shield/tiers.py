"""One property, two tests: a few examples always, many in the slow tier."""

import types
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis.strategies import SearchStrategy

_COMMON: dict[str, Any] = {
    "deadline": None,
    "derandomize": True,
    "suppress_health_check": list(HealthCheck),
}


def two_tiers(
    fast: int = 500, slow: int = 10_000, **strategies: SearchStrategy[Any]
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Turn a property into a test, and register its slow twin in the same module.

    Args:
        fast: Examples of the one.
        slow: Examples of the other.
        **strategies: Arguments of the property.
    """

    def decorate(check: Callable[..., None]) -> Callable[..., None]:
        assert isinstance(check, types.FunctionType)
        name = f"{check.__name__}_10k" if slow >= 10_000 else f"{check.__name__}_slow"
        twin = types.FunctionType(check.__code__, check.__globals__, name)
        twin.__doc__, twin.__module__ = check.__doc__, check.__module__
        twin.__qualname__ = twin.__name__
        long = settings(max_examples=slow, **_COMMON)(given(**strategies)(twin))
        check.__globals__[twin.__name__] = pytest.mark.timeout(3600)(pytest.mark.slow(long))
        return settings(max_examples=fast, **_COMMON)(given(**strategies)(check))

    return decorate
