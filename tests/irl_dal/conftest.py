from __future__ import annotations

import sys
from collections.abc import Callable

import pytest

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
