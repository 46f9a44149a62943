"""What results depend on, in twelve digits."""

from pathlib import Path

import pytest

import expert
import irl_dal
import shield
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
    """Tiny packages in the place of ours: the folder of `irl_dal`."""
    for name, text in (
        ("../expert/fsm.py", "GAIN = 1.0\n"),
        ("../shield/limits.py", "BOUND = 1.0\n"),
        ("loop.py", '"""Title."""\n\nSPEED = 1.0  # [m/s]\n"""Why."""\n'),
        ("envs/car.urdf", "<robot/>"),
        ("figures/page.py", "COLOUR = 1\n"),
    ):
        (tmp_path / "irl_dal" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "irl_dal" / name).write_text(text)
    for ours in (irl_dal, expert, shield):
        monkeypatch.setattr(ours, "__path__", [str(tmp_path / ours.__name__)])
    assert module.irl_dal is irl_dal
    return tmp_path / "irl_dal"


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
        ("../expert/fsm.py", "GAIN = 2.0\n", True),
        ("../shield/limits.py", "BOUND = 2.0\n", True),
    ],
)
def test_code_counts_as_it_is_executed(package: Path, name: str, text: str, changes: bool) -> None:
    """Words and what only shows results do not count, every other edit does."""
    before = code_fingerprint()
    (package / name).write_text(text)
    assert (code_fingerprint() != before) == changes
