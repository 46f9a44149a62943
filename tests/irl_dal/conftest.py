from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from irl_dal.comparison.drive import Subject
from irl_dal.comparison.suite import compare
from irl_dal.figures.comparison_page import write_page
from irl_dal.storage.atomic import write_json
from tests.irl_dal.comparison.tiny import tiny_subject, untrained_run

Console = Callable[..., str]


@pytest.fixture
def console(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Console:
    """Runs a command as its console would; what it printed, or its one line of complaint."""

    def run(main: Callable[[], None], *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [main.__module__, *arguments])
        capsys.readouterr()
        try:
            main()
        except SystemExit as end:
            printed = capsys.readouterr()
            assert end.code == 2
            lines = printed.err.splitlines()
            assert len(lines) == 1 and lines[0].startswith("error: ")
            return lines[0]
        return capsys.readouterr().out

    return run


@dataclass(frozen=True)
class Compared:
    """A complete comparison."""

    subject: Subject
    report: dict[str, Any]


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder."""
    return untrained_run(tmp_path_factory.mktemp("compare") / "runs" / "tiny")


@pytest.fixture(scope="session")
def compared(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Compared:
    """A comparison on it with its page."""
    subject = tiny_subject(run, tmp_path_factory.mktemp("compared") / "out")
    report = compare(subject)
    write_json(subject.store.report, report)
    write_page(subject, report)
    return Compared(subject, report)
