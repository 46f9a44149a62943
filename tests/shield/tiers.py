"""One property, two tests: 500 examples always, 10,000 in the slow tier."""

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
    **strategies: SearchStrategy[Any],
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Turn a property into a test, and register its slow twin in the same module.

    Args:
        **strategies: Arguments of the property.
    """

    def decorate(check: Callable[..., None]) -> Callable[..., None]:
        assert isinstance(check, types.FunctionType)
        twin = types.FunctionType(check.__code__, check.__globals__, f"{check.__name__}_10k")
        twin.__doc__, twin.__module__ = check.__doc__, check.__module__
        twin.__qualname__ = twin.__name__
        slow = settings(max_examples=10_000, **_COMMON)(given(**strategies)(twin))
        check.__globals__[twin.__name__] = pytest.mark.timeout(3600)(pytest.mark.slow(slow))
        return settings(max_examples=500, **_COMMON)(given(**strategies)(check))

    return decorate
