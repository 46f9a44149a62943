import json
from pathlib import Path

import pytest

from irl_dal.evaluation.references import ReferenceCache


def test_what_was_added_is_known(tmp_path: Path) -> None:
    """Also to another reader of the file."""
    cache = ReferenceCache.beside(tmp_path, "city")
    assert cache.known("expert") == {}
    cache.add("expert", {1: 10.0, 3: 30.0})
    cache.add("random", {1: -1.0})
    cache.add("random", {3: -3.0})
    other = ReferenceCache(cache.path, "city")
    assert other.known("expert") == {1: 10.0, 3: 30.0}
    assert other.known("random") == {1: -1.0, 3: -3.0}


def test_cities_do_not_mix(tmp_path: Path) -> None:
    """Another city's returns are not known; both stay in the file."""
    first, second = (ReferenceCache.beside(tmp_path, name) for name in ("first", "second"))
    first.add("expert", {1: 1.0})
    assert second.known("expert") == {}
    second.add("expert", {1: 2.0})
    assert sorted(json.loads(first.path.read_text())) == ["first", "second"]
    assert first.known("expert") == {1: 1.0}


@pytest.mark.parametrize(
    "content", ["", "{", "[1]", '{"city": [1]}', '{"city": {"expert": {"one": 1.0}}}']
)
def test_a_damaged_file_is_an_empty_cache(tmp_path: Path, content: str) -> None:
    """It only saves time: what cannot be read is driven again."""
    cache = ReferenceCache.beside(tmp_path, "city")
    cache.path.write_text(content)
    assert cache.known("expert") == {}
    cache.add("expert", {1: 1.0})
    assert cache.known("expert") == {1: 1.0}
