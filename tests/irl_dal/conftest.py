import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from irl_dal.comparison import drive, experiment, planning
from irl_dal.comparison.drive import ComparisonJob
from irl_dal.comparison.experiment import compare
from irl_dal.figures.comparison_page import write_comparison_page
from irl_dal.storage import result_store
from irl_dal.storage.atomic import write_json
from tests.irl_dal.comparison.tiny import tiny_job, untrained_run
from tests.irl_dal.tiny_run import sweep

Console = Callable[..., str]


@pytest.fixture(scope="session", autouse=True)
def code_is_not_read() -> Iterator[None]:
    """A process's code does not change; its fingerprint takes 1 s for each key of a result."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(result_store, "code_fingerprint", lambda: "the code")
        yield


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


@pytest.fixture(scope="session")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep over two variants; whoever changes a run copies it."""
    folder = tmp_path_factory.mktemp("sweep")
    sweep(folder)
    return folder / "runs"


@dataclass(frozen=True)
class Compared:
    """A complete comparison."""

    job: ComparisonJob
    results: dict[str, Any]


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder."""
    return untrained_run(tmp_path_factory.mktemp("compare") / "runs" / "tiny")


@pytest.fixture(scope="session")
def short() -> Iterator[None]:
    """Comparisons of drives of two seconds: short paths, two states per episode."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in (
            (drive, "PATH_DURATION", 0.5),
            (experiment, "PATH_DURATION", 0.5),
            (planning, "STATES", 2),
            (experiment, "STATES", 2),
        ):
            patch.setattr(module, name, value)
        yield


@pytest.fixture(scope="session")
def compared(run: Path, short: None, tmp_path_factory: pytest.TempPathFactory) -> Compared:
    """A comparison on it with its page."""
    job = tiny_job(run, tmp_path_factory.mktemp("compared") / "out")
    results = compare(job)
    write_json(job.results, results)
    write_comparison_page(job, results)
    return Compared(job, results)
