"""What the tests of `shield` share: the slow tier and reproducible draws."""

from collections.abc import Iterable

import numpy as np
import pytest


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the slow tier out unless `-m` asks for something."""
    if config.getoption("-m"):
        return
    slow = [item for item in items if item.get_closest_marker("slow")]
    if slow:
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if item not in set(slow)]


@pytest.fixture
def rng() -> Iterable[np.random.Generator]:
    """A generator with a fixed seed."""
    return np.random.default_rng(20261122)
