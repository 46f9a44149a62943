import json
from pathlib import Path

import pytest

from irl_dal.storage.atomic import write_json, write_text


def test_json_is_written_at_once_or_not_at_all(tmp_path: Path) -> None:
    """A number that is no JSON leaves the old file as it was, and nothing beside it."""
    path = tmp_path / "deep" / "report.json"
    write_json(path, {"success": 1.0})
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"success": float("nan")})
    assert json.loads(path.read_text()) == {"success": 1.0}
    assert list(path.parent.iterdir()) == [path]


def test_a_failed_write_leaves_nothing_beside_the_target(tmp_path: Path) -> None:
    """A folder in the target's place: the system's own error, and no partial file."""
    (tmp_path / "report.json").mkdir()
    with pytest.raises(OSError):
        write_text(tmp_path / "report.json", "text")
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
