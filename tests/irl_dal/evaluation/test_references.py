import json
from pathlib import Path

import numpy as np
import pytest

from irl_dal.evaluation.references import ReferenceCache


def test_returns_come_back_in_the_order_of_the_seeds(tmp_path: Path) -> None:
    """What was added is no longer missing and is found by another reader of the file."""
    cache = ReferenceCache.beside(tmp_path, "city")
    assert cache.missing("expert", [3, 1]) == [3, 1]
    cache.add("expert", {1: 10.0, 3: 30.0})
    cache.add("random", {1: -1.0})
    cache.add("random", {3: -3.0})
    other = ReferenceCache(cache.path, "city")
    assert other.missing("expert", [3, 1, 2]) == [2]
    returns = other.returns([3, 1])
    np.testing.assert_array_equal(returns.expert, [30.0, 10.0])
    np.testing.assert_array_equal(returns.random, [-3.0, -1.0])


def test_cities_do_not_mix(tmp_path: Path) -> None:
    """Another city's returns are missing; both stay in the file."""
    first, second = (ReferenceCache.beside(tmp_path, name) for name in ("first", "second"))
    first.add("expert", {1: 1.0})
    assert second.missing("expert", [1]) == [1]
    second.add("expert", {1: 2.0})
    assert sorted(json.loads(first.path.read_text())) == ["first", "second"]
    with pytest.raises(KeyError):
        first.returns([1])


@pytest.mark.parametrize("content", ["", "{", "[1]"])
def test_a_damaged_file_is_an_empty_cache(tmp_path: Path, content: str) -> None:
    """It only saves time: what cannot be read is driven again."""
    cache = ReferenceCache.beside(tmp_path, "city")
    cache.path.write_text(content)
    assert cache.missing("expert", [1]) == [1]
    cache.add("expert", {1: 1.0})
    assert cache.missing("expert", [1]) == []
