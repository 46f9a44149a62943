import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from shutil import copytree

import pytest

from irl_dal import compare
from tests.irl_dal.comparison.tiny import TINY, tiny_config, untrained_run
from tests.irl_dal.conftest import Compared

Call = Callable[..., str]

SMALL = (
    "episodes=1",
    "projections=[none,x0]",
    "activations=[alone]",
    f"candidates={TINY.candidates}",
    "film_duration=0",
    "n_jobs=1",
)


@pytest.fixture
def call(console: Call) -> Call:
    """The command on its console."""
    return partial(console, compare.main)


def test_the_command_prints_and_writes(
    run: Path, call: Call, compared: Compared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tables, numbers and page of what has been driven; then another comparison in its place."""
    out = tmp_path / "results"
    copytree(compared.job.out / "driven", out / "driven")
    printed = call(f"run={run}", f"out={out}", *SMALL)
    assert "planner alone, 1 episodes" in printed and str(out / "index.html") in printed
    report = json.loads((out / "compare.json").read_text())
    assert report["arms"]["alone-x0-shield"]["command_violation_rate"] == 0.0
    assert report["settings"]["projections"] == ["none", "x0"]
    assert "<video" not in (out / "index.html").read_text()
    assert not (out / "film.webm").exists()
    assert len(list((out / "driven").iterdir())) == 1
    monkeypatch.setattr(compare, "write_comparison_page", lambda *_: None)
    call(f"run={run}", f"out={out}", *SMALL, "episodes=2")
    assert json.loads((out / "compare.json").read_text())["settings"]["episodes"] == 2


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("", ["run = None"]),
        ("run=nowhere", ["run = 'nowhere'", "no such folder"]),
        ("run=RUN episodes=0", ["episodes", "Got 0"]),
        ("run=RUN projections=[x0]", ["projections", "none"]),
        ("run=RUN projections=[none,all]", ["projections", "'all'", "adaptive"]),
        ("run=RUN projections=x0", ["projections = 'x0'"]),
        ("run=RUN shield=off", ["shield = ", "varies"]),
        ("run=RUN planner.projection=xt", ["planner.projection = 'xt'", "varies"]),
        ("run=RUN variant=paper", ["variant = 'paper'", "settled"]),
        ("run=RUN film_duration=inf", ["film_duration", "Got inf"]),
        ("run=RUN film_duration=nan", ["film_duration", "Got nan"]),
        ("run=RUN n_jobs=0", ["n_jobs", "Got 0"]),
        ("run=RUN episode=3", ["episode = 3", "no such key"]),
        ("run=RUN planner.horizon=7", ["planner.horizon", "Got 7"]),
    ],
)
def test_a_mistake_gets_one_line(
    run: Path, call: Call, tmp_path: Path, arguments: str, named: list[str]
) -> None:
    """Key and value on one line, exit code 2, nothing written."""
    out = tmp_path / "results"
    line = call(*arguments.replace("RUN", str(run)).split(), f"out={out}")
    for part in named:
        assert part in line
    assert not out.exists() and not (run / "comparison").exists()


def test_a_folder_that_cannot_be_made_is_refused(run: Path, call: Call, tmp_path: Path) -> None:
    """Before anything is driven."""
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        line = call(f"run={run}", f"out={out}", *SMALL)
        assert "out = " in line and str(tmp_path / "file") in line


def test_a_run_without_a_planner_is_refused(call: Call, tmp_path: Path) -> None:
    """There is nothing to compare."""
    config = tiny_config()
    off = replace(config, planner=replace(config.planner, enabled=False))
    run = untrained_run(tmp_path / "runs" / "bare", off)
    assert "without a planner" in call(f"run={run}")


def test_weights_of_another_network_are_refused(run: Path, call: Call, tmp_path: Path) -> None:
    """The complaint comes before anything is written."""
    out = tmp_path / "results"
    line = call(f"run={run}", f"out={out}", *SMALL, "planner.width=16")
    assert "not fit the configuration" in line and not out.exists()
