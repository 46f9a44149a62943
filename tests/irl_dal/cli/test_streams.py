"""Results reach the terminal and their file, or the command refuses before it computes them."""

import io
import sys
from pathlib import Path

import pytest
from omegaconf import DictConfig

from irl_dal.cli.command import one_line_errors, run_command
from irl_dal.cli.overrides import require_writable
from irl_dal.config import ConfigError


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_a_terminal_without_utf8_shows_a_question_mark(
    monkeypatch: pytest.MonkeyPatch, encoding: str
) -> None:
    """What it cannot show costs nothing else of the line."""
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    with pytest.raises(UnicodeEncodeError):
        sys.stdout.write("─ m/s³")
    with one_line_errors():
        print("a ─ b", flush=True)
    assert raw.getvalue() == b"a ? b\n"


def test_a_target_that_can_be_written_is_left_as_it_is(tmp_path: Path) -> None:
    """A file's content stays, folders above it are made, nothing else."""
    (tmp_path / "old.json").write_text("old")
    require_writable("out", tmp_path / "old.json")
    require_writable("out", tmp_path / "deep" / "er" / "new.json")
    require_writable("out", tmp_path / "page", folder=True)
    assert (tmp_path / "old.json").read_text() == "old"
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == [
        "deep", "deep/er", "old.json", "page",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("target", "folder"),
    [
        ("file/numbers.json", False),
        ("file/deep/numbers.json", False),
        ("folder", False),
        ("/dev/null", False),
        ("/proc/numbers.json", False),
        ("x" * 300, False),
        ("file", True),
        ("file/page", True),
        ("/proc/page", True),
    ],
)
def test_a_target_that_cannot_be_written_is_named(
    tmp_path: Path, target: str, folder: bool
) -> None:
    """One line with key and path, whatever the system's own error is."""
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(ConfigError, match=r"^out = '[^\n]*'?: [^\n]+$") as error:
        require_writable("out", tmp_path / target, folder=folder)
    assert target in str(error.value)


@pytest.mark.parametrize("words", ["", "4 drives are kept"])
def test_an_interruption_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: str
) -> None:
    """With what the command says of it, and the exit code of a shell."""

    def task(_: DictConfig) -> None:
        raise KeyboardInterrupt(*([words] if words else []))

    monkeypatch.setattr(sys, "argv", ["evaluate", "policy=expert"])
    with pytest.raises(SystemExit) as end:
        run_command(task, "evaluate")
    assert end.value.code == 130
    (line,) = capsys.readouterr().err.splitlines()
    assert line == ("interrupted; 4 drives are kept" if words else "interrupted")
