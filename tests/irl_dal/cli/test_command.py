from collections.abc import Callable
from pathlib import Path

import pytest

from irl_dal import compare, evaluate, report, train
from irl_dal.cli.command import new_console
from irl_dal.config import RunConfig
from irl_dal.storage.run_folder import create_run
from tests.irl_dal.comparison.tiny import untrained_run

Call = Callable[..., str]


@pytest.mark.parametrize(
    ("argument", "parts"),
    [
        ("run=runs/date=2026-01-01", ["run = runs/date=2026-01-01", "quoted", "\"run='runs/date="]),
        ("env.track=~/road.csv", ["env.track = ~/road.csv", "quoted"]),
        ("run=runs/[a]", ["run = runs/[a]", "quoted", "\"run='runs/[a]'\""]),
        ("run=it's", ["run = it's", "quoted"]),
        ("run=[a]", ["run = ['a']", "quote"]),
        ("out=1e3", ["out = 1000.0", "quote"]),
        ("out=", ["out = ''"]),
        ("seed", ["seed", "key=value"]),
        ("=3", ["=3", "key=value"]),
        ("shield=3", ["shield = 3", "off"]),
        ("planner=null", ["planner = null", "off"]),
        ("+evaluation.episodes=2", ["evaluation.episodes = 2", "without the +"]),
        ("+shield=off", ["shield = off", "without the +"]),
        ("+device=cuda", ["+device=cuda", "without the +"]),
        ("++device=cuda", ["++device=cuda", "without the +"]),
        ("+shield.max_speed=9", ["+shield.max_speed=9", "limits.max_speed"]),
        ("~shield", ["~shield", "removed"]),
        ("~seed", ["~seed", "removed"]),
        ("~nothing", ["~nothing", "removed"]),
        ("out=${nowhere}", ["out=${nowhere}", "nowhere"]),
        ("shield.solver=OSQP", ["shield.solver", "OSQP"]),
    ],
)
def test_an_argument_that_cannot_be_used_is_named(
    console: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, argument: str, parts: list[str]
) -> None:
    """Key and value on one line with the remedy, exit code 2, nothing written."""
    monkeypatch.chdir(tmp_path)
    own = [] if argument.startswith("run=") else ["policy=expert"]
    line = console(evaluate.main, *own, argument)
    for part in parts:
        assert part in line
    assert "Lexer" not in line and list(tmp_path.iterdir()) == []


def test_nothing_is_begun_with_an_unknown_solver(
    console: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No run folder is left behind."""
    monkeypatch.chdir(tmp_path)
    assert "shield.solver" in console(train.main, "preset=smoke", "shield.solver=OSQP")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["[red]", "a=b", "it's", 'with "quotes"', "two words", "a,b{c}:d:"]
)
def test_any_name_of_a_folder_works_quoted(console: Call, tmp_path: Path, name: str) -> None:
    """Brackets, signs, blanks and quotes reach the command as they are, and its messages."""
    folder = tmp_path / name
    create_run(folder, RunConfig())
    line = console(train.main, "run_dir='" + str(folder).replace("'", "\\'") + "'")
    assert f"run_dir = {str(folder)!r}: exists already" in line


def test_the_console_prints_names_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    """Square brackets and colons in a path are no markup."""
    new_console().print("runs/[red]x[/red]/:smile:", soft_wrap=True)
    assert capsys.readouterr().out == "runs/[red]x[/red]/:smile:\n"


@pytest.mark.parametrize("seed", ["abc", "-1", "1.5", "null"])
def test_the_seed_of_the_bootstrap_is_checked(console: Call, tmp_path: Path, seed: str) -> None:
    """Before a run is read."""
    line = console(report.main, f"runs={tmp_path}", f"seed={seed}")
    assert line.startswith("error: seed = ")


def test_a_folder_for_pages_that_cannot_be_made_is_refused_first(
    console: Call, tmp_path: Path
) -> None:
    """Before anything is read or driven."""
    (tmp_path / "file").touch()
    assert "out = " in console(report.main, f"runs={tmp_path}", f"out={tmp_path}/file/out")
    run = untrained_run(tmp_path / "runs" / "R")
    assert "out = " in console(compare.main, f"run={run}", f"out={tmp_path}/file/out")
