"""What importing and running the package promises."""

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import shield
from shield.bench.__main__ import main

ROOT = Path(__file__).parents[2]
HEAVY = ("torch", "pybullet", "stable_baselines3", "gymnasium", "matplotlib", "irl_dal", "expert")


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python in the repository."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )


def test_importing_shield_imports_nothing_heavy() -> None:
    """In a fresh process, neither learning library nor simulator nor gymnasium is loaded."""
    code = f"import shield, sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    assert run("-c", code).stdout.strip() == "[]"


def test_without_gymnasium_the_error_is_the_pip_line() -> None:
    """`shield.gym` says how to get what it lacks."""
    code = (
        "import sys; sys.modules['gymnasium'] = None\n"
        "try:\n    import shield.gym\n"
        "except ImportError as error:\n    print(type(error).__name__, error)"
    )
    assert run("-c", code).stdout.strip() == (
        "MissingDependency shield.gym needs gymnasium: pip install gymnasium"
    )


def test_the_public_names_are_sorted_and_there() -> None:
    """`__all__` is the interface."""
    assert shield.__all__ == sorted(shield.__all__)
    assert all(hasattr(shield, name) for name in shield.__all__)
    assert (ROOT / "shield" / "py.typed").exists()


@pytest.mark.parametrize("name", ["own_constraint", "shielded_planner", "shielded_pendulum"])
def test_the_examples_run(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Each prints something, within a page of code."""
    if name == "shielded_pendulum":
        pytest.importorskip("gymnasium")
    path = ROOT / "examples" / f"{name}.py"
    assert 40 <= len(path.read_text(encoding="utf-8").splitlines()) <= 100
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out


@pytest.mark.parametrize("steps", [400, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_small_robot_touches_nothing(capsys: pytest.CaptureFixture[str], steps: int) -> None:
    """Which it does without the filter."""
    pytest.importorskip("gymnasium")
    runpy.run_path(str(ROOT / "examples" / "small_robot.py"))["main"](steps)
    without, with_it = (
        [int(number) for number in re.findall(r"\d+", line)]
        for line in capsys.readouterr().out.splitlines()
    )
    assert without[2] > 5 and with_it[2] == 0 and with_it[0] > 0.05 * steps


@pytest.mark.slow
def test_on_the_racetrack_only_the_bare_driver_leaves_the_road(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One drive of each kind of driver."""
    pytest.importorskip("highway_env")
    example = runpy.run_path(str(ROOT / "examples" / "highway_racetrack.py"))
    example["main"](drives=1)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4 and "1 departures" in lines[0]
    assert all(f"0 {end}" in line for end in example["ENDS"][:2] for line in (lines[1], lines[3]))


def test_the_bench_prints_and_writes_its_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The quick form of everything, on short streets, as text and as JSON."""
    monkeypatch.setattr("shield.bench.predictive.STEPS", 25)
    numbers = main(["all", "--quick", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    written = json.loads((tmp_path / "all.json").read_text(encoding="utf-8"))
    for name in (
        "ratio_to_bare_osqp_1e-08",
        "ratio_to_casadi_conic_osqp",
        "project_violations",
        "false_alarms_tracked_over_raw",
        "filter_1080_beams_random_p99_ms",
    ):
        assert name in printed
        assert written[name] == numbers[name]
    assert written["python"]
    assert numbers["project_violations"] == numbers["project_lateral_bending_violations"] == 0
