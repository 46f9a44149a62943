"""The city's benchmarks print what they say they print."""

from dataclasses import replace

import numpy as np
import pytest

from irl_dal.bench.__main__ import main
from irl_dal.bench.car import speed_response, steering_response
from irl_dal.bench.drive import expert_drives
from irl_dal.bench.lane import lane_numbers
from irl_dal.bench.speed import compare_speed, missing_peers, parts_table, speed_table
from irl_dal.envs import CityConfig

SHORT = CityConfig(route_length=100.0, route_spread=0.0, difficulty="easy")


def test_lane_numbers_are_those_of_the_errors() -> None:
    """Recomputed by hand on a drive with known errors."""
    drive = next(iter(expert_drives(SHORT, [4])))
    wrong = drive.tracked.copy()
    wrong[:3] += 5.0
    numbers = lane_numbers([replace(drive, tracked=wrong)])
    error = (wrong - drive.offset)[drive.valid]
    assert numbers["rmse_tracked_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert numbers["confidently_wrong_share"] == pytest.approx(
        drive.valid[:3].sum() / len(drive.valid)
    )
    assert numbers["measured_share"] == pytest.approx(np.isfinite(drive.measured).mean())
    assert drive.outcome == "success" and drive.steps == len(drive.offset) - 1


def test_speed_is_positive_and_peers_are_named() -> None:
    """The city is in the table; what is missing says which package brings it."""
    rates = compare_speed(1, 5, SHORT)
    assert rates["IRLDAL/City-v0"] > 0.0
    assert set(rates) | set(missing_peers()) >= {"CarRacing-v3", "racetrack-v0"}
    assert speed_table(rates).row_count == len(rates)
    assert parts_table(5, SHORT).row_count >= 6


def test_the_car_is_nearly_a_bicycle() -> None:
    """Inside the bounds gains are within 3 %; far outside the tyres slide."""
    calm = steering_response(8.0, float(np.arctan(2.7 * 2.0 / 64.0)))
    assert calm.gain == pytest.approx(1.0, abs=0.03) and calm.rise < 0.25
    wild = steering_response(12.0, float(np.arctan(2.7 * 14.0 / 144.0)))
    assert wild.gain < 0.9 and wild.slip > 3.0 * calm.slip
    assert speed_response(5.0, 5.3).gain == pytest.approx(1.0, abs=0.01)


def test_commands_print_tables(capsys: pytest.CaptureFixture[str]) -> None:
    """`lane` shows errors, validity and the expert's own violations."""
    assert main(["lane", "--episodes", "1", "--difficulty", "easy", "--first-seed", "3"]) == 0
    text = capsys.readouterr().out
    for words in ("RMSE after tracking", "valid estimate", "confidently wrong", "own violations"):
        assert words in text


def test_a_bad_track_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and the reason."""
    assert main(["expert", "--track", "nowhere.csv"]) == 2
    assert capsys.readouterr().err.strip().count("\n") == 0
