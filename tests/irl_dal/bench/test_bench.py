"""The city's benchmarks print what they say they print."""

from dataclasses import replace

import numpy as np
import pytest
from rich.table import Table

from irl_dal.bench.__main__ import main
from irl_dal.bench.car import speed_response, steering_response
from irl_dal.bench.drive import expert_drives, lane_numbers
from irl_dal.bench.speed import PEERS, compare_speed, parts_table, speed_tables
from irl_dal.envs import CityConfig

SHORT = CityConfig(route_length=80.0, route_spread=0.0, difficulty="easy")


def test_lane_numbers_are_those_of_the_errors() -> None:
    """Recomputed by hand on a drive with known errors."""
    (drive,) = expert_drives(SHORT, [4])
    wrong = drive.tracked.copy()
    wrong[:3] += 5.0
    numbers = lane_numbers([replace(drive, tracked=wrong)])
    error = (wrong - drive.offset)[drive.valid]
    assert numbers["RMSE after tracking [m]"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert numbers["confidently wrong"] == pytest.approx(drive.valid[:3].sum() / len(drive.valid))
    assert numbers["steps with a measurement"] == pytest.approx(np.isfinite(drive.measured).mean())
    assert drive.outcome == "success" and len(drive.commands) == len(drive.offset) - 1


def test_speed_is_positive_and_peers_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The city is in the table; what is missing says which package brings it."""
    rates = compare_speed(1, 5, SHORT)
    assert rates["IRLDAL/City-v0"] > 0.0
    monkeypatch.setattr("irl_dal.bench.speed.compare_speed", lambda *_: rates)
    first, *others = speed_tables(1, 5, SHORT)
    assert isinstance(first, Table) and first.row_count == len(rates)
    named = " ".join(line for line in others if isinstance(line, str))
    assert {name for name in PEERS if name in named} == PEERS.keys() - rates.keys()
    assert parts_table(5, SHORT).row_count >= 6


def test_the_car_is_nearly_a_bicycle() -> None:
    """Inside the bounds gains are within 3 %; far outside the tyres slide."""
    calm = steering_response(8.0, float(np.arctan(2.7 * 2.0 / 64.0)))
    assert calm.gain == pytest.approx(1.0, abs=0.03) and calm.rise < 0.25
    wild = steering_response(12.0, float(np.arctan(2.7 * 14.0 / 144.0)))
    assert wild.gain < 0.9 and wild.slip > 3.0 * calm.slip
    assert speed_response(5.0, 5.3).gain == pytest.approx(1.0, abs=0.01)


def test_commands_print_tables(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`lane` shows errors, validity and the ride."""
    monkeypatch.setattr("irl_dal.bench.__main__._city", lambda _: SHORT)
    main(["lane", "--episodes", "1", "--jobs", "1", "--first-seed", "3"])
    text = capsys.readouterr().out
    for words in ("RMSE after tracking", "valid estimate", "confidently wrong", "jerk"):
        assert words in text


def test_a_bad_track_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and the reason."""
    with pytest.raises(SystemExit, match="2"):
        main(["expert", "--track", "nowhere.csv"])
    assert capsys.readouterr().err.strip().count("\n") == 0


@pytest.mark.parametrize(
    ("command", "option", "value"),
    [
        *(("env", option, "0") for option in ("--rounds", "--steps", "--route-length")),
        *(("expert", option, "0") for option in ("--episodes", "--jobs")),
        *(("faults", option, "-1") for option in ("--episodes", "--jobs", "--first-seed")),
        *(("lane", "--first-seed", value) for value in ("-1", "1.5", "x", "99999999999")),
        *(("env", "--route-length", value) for value in ("-1", "nan", "inf", "far")),
        *(("planner", option, "0") for option in ("--rounds", "--contexts")),
        ("car", "--rounds", "3"),
    ],
)
def test_a_number_without_sense_is_one_line(
    command: str, option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 and the option's name, for every numeric option; none is ignored."""
    with pytest.raises(SystemExit) as end:
        main([command, option, value])
    line = capsys.readouterr().err
    assert end.value.code == 2 and option in line and line.count("\n") == 1


def test_an_unknown_difficulty_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """The value is shown."""
    with pytest.raises(SystemExit, match="2"):
        main(["expert", "--difficulty", "insane"])
    line = capsys.readouterr().err.strip()
    assert "insane" in line and line.count("\n") == 0


def test_units_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """Brackets in a heading are no markup."""
    main(["car"])
    assert "[m/s²]" in capsys.readouterr().out
