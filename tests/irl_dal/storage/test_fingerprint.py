"""What results depend on, in twelve digits."""

from pathlib import Path

import pytest

import irl_dal
from irl_dal.storage import result_store as module
from irl_dal.storage.result_store import code_fingerprint, fingerprint


def test_it_changes_with_texts_and_files(tmp_path: Path) -> None:
    """And where two parts share their bytes differently."""
    weights = tmp_path / "weights.bin"
    weights.write_bytes(b"\0\1")
    first = fingerprint("settings", weights)
    assert len(first) == 12 and int(first, 16) >= 0
    weights.write_bytes(b"\0\2")
    assert len({first, fingerprint("settings", weights), fingerprint("setting", weights)}) == 3
    assert fingerprint("ab", "c") != fingerprint("a", "bc")


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A tiny package in the place of ours."""
    for name, text in (
        ("loop.py", '"""Title."""\n\nSPEED = 1.0  # [m/s]\n"""Why."""\n'),
        ("envs/car.urdf", "<robot/>"),
        ("figures/page.py", "COLOUR = 1\n"),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(irl_dal, "__path__", [str(tmp_path)])
    assert module.irl_dal is irl_dal
    return tmp_path


@pytest.mark.parametrize(
    ("name", "text", "changes"),
    [
        ("loop.py", "SPEED   =   1.0\n", False),
        ("loop.py", '"""Another title."""\n# why\nSPEED = 1.0\n', False),
        ("figures/page.py", "COLOUR = 2\n", False),
        ("envs/notes.txt", "no source", False),
        ("loop.py", "SPEED = 1.5\n", True),
        ("loop.py", 'SPEED = 1.0\nNAME = "Title."\n', True),
        ("envs/car.urdf", "<robot name='car'/>", True),
        ("envs/new.py", "ANYTHING = 0\n", True),
    ],
)
def test_code_counts_as_it_is_executed(package: Path, name: str, text: str, changes: bool) -> None:
    """Words and what only shows results do not count, every other edit does."""
    before = code_fingerprint()
    (package / name).write_text(text)
    assert (code_fingerprint() != before) == changes
