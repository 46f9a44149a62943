"""The clearance is tracked, coasts, rejects, and never makes a blind car confident."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import ClearanceTracker, InvalidProblem
from shield.bench.estimation import ScanFaults, simulate_drive, tracking_against_raw
from shield.estimation.scan import ScanFilter
from tests.shield.strategies import NASTY
from tests.shield.tiers import two_tiers

DT = 0.1


def wall(distance: float, rng: np.random.Generator, noise: float = 0.05) -> np.ndarray:
    """Return a scan of an obstacle twenty beams wide."""
    scan = np.full(180, 40.0)
    scan[80:100] = distance + rng.normal(0.0, noise, 20)
    return scan


def test_clearance_and_closing_speed_are_tracked(rng: np.random.Generator) -> None:
    """An approach at 5 m/s, within three standard deviations of the truth."""
    tracker = ClearanceTracker(DT)
    for step in range(40):
        estimate = tracker.update(wall(30.0 - 0.5 * step, rng))
    assert estimate.clearance == pytest.approx(10.5, abs=0.2)
    assert estimate.closing_speed == pytest.approx(5.0, abs=0.7)
    assert estimate.valid
    assert estimate.age == 0.0
    assert 0.0 < estimate.std < 0.1


def test_a_scan_that_somebody_else_has_cleaned_says_the_same(rng: np.random.Generator) -> None:
    """Also of a scanner that goes dead while the car drives."""
    raw, cleaned, scans = ClearanceTracker(DT), ClearanceTracker(DT), ScanFilter(40.0)
    ranges = [wall(30.0 - 0.5 * step, rng) for step in range(10)]
    for scan in [*ranges, *[ranges[-1]] * 10]:
        estimate = raw.update(scan, 5.0)
        assert cleaned.update(scans.examine(scan, 5.0)) == estimate
    assert not estimate.valid


def test_a_new_obstacle_is_followed_within_the_same_step(rng: np.random.Generator) -> None:
    """A drop of 20 m seen by neighbouring beams passes the gate; one beam does not."""
    tracker = ClearanceTracker(DT)
    for _ in range(20):
        tracker.update(wall(25.0, rng))
    spurious = wall(25.0, rng)
    spurious[30] = 1.0
    assert tracker.update(spurious).clearance > 24.0
    assert tracker.update(wall(5.0, rng)).clearance == pytest.approx(5.0, abs=0.2)


def test_a_vanishing_obstacle_has_to_be_confirmed(rng: np.random.Generator) -> None:
    """Two scans without it change nothing, the third is believed."""
    tracker = ClearanceTracker(DT)
    for _ in range(10):
        tracker.update(wall(5.0, rng))
    free = [tracker.update(np.full(180, 40.0)) for _ in range(3)]
    assert [estimate.clearance < 6.0 for estimate in free] == [True, True, False]
    assert free[1].age == pytest.approx(0.2)
    assert free[2].clearance == 40.0
    assert free[2].closing_speed <= 0.0


def test_missing_scans_coast_grow_uncertain_and_expire(rng: np.random.Generator) -> None:
    """The obstacle goes on approaching in the dark; after max_age the estimate is invalid."""
    tracker = ClearanceTracker(DT, max_age=0.3)
    for step in range(20):
        estimate = tracker.update(wall(20.0 - 0.5 * step, rng))
    dark = [tracker.update(None) for _ in range(5)]
    assert [one.age for one in dark] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert [one.valid for one in dark] == [True, True, False, False, False] or [
        one.valid for one in dark
    ] == [True, True, True, False, False]
    values = [estimate, *dark]
    assert all(a.clearance > b.clearance for a, b in zip(values, values[1:], strict=False))
    assert all(a.std < b.std for a, b in zip(values, values[1:], strict=False))
    assert tracker.update(np.full(180, np.nan)).age == pytest.approx(0.6)
    assert tracker.update(wall(7.0, rng)).age == 0.0


def test_before_the_first_scan_nothing_is_valid() -> None:
    """And after a reset neither."""
    tracker = ClearanceTracker(DT)
    assert not tracker.update(None).valid
    assert tracker.update(np.full(180, 9.0)).valid
    tracker.reset()
    estimate = tracker.update(None)
    assert not estimate.valid
    assert math.isinf(estimate.age)


def test_the_clearance_does_not_become_negative(rng: np.random.Generator) -> None:
    """Coasting through an obstacle stops at zero."""
    tracker = ClearanceTracker(DT)
    for step in range(10):
        tracker.update(wall(6.0 - 0.5 * step, rng))
    for _ in range(20):
        assert tracker.update(None).clearance >= 0.0


@two_tiers(
    fast=200, values=st.lists(st.lists(NASTY, min_size=12, max_size=12), min_size=1, max_size=6)
)
def test_any_scan_leaves_the_tracker_finite(values: list[list[float]]) -> None:
    """NaN, infinities and huge values never reach the state."""
    tracker = ClearanceTracker(DT)
    for scan in values:
        estimate = tracker.update(scan)
        assert 0.0 <= estimate.clearance <= 40.0
        assert math.isfinite(estimate.closing_speed)
        assert math.isfinite(estimate.std)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [("speed", (np.ones(9), "fast")), ("speed", (np.ones(9), [1.0])), ("scan", ("far", 1.0))],
)
def test_what_is_not_a_number_raises(name: str, arguments: Any) -> None:
    """Naming the argument: types are mistakes of the caller, values are not."""
    with pytest.raises(InvalidProblem, match=f"`{name}`"):
        ClearanceTracker(DT).update(*arguments)


@pytest.mark.parametrize("argument", ["dt", "max_range", "max_age"])
@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf, "often"])
def test_impossible_settings_raise(argument: str, value: Any) -> None:
    """Naming the argument."""
    with pytest.raises(InvalidProblem, match=f"`{argument}`"):
        ClearanceTracker(**{"dt": DT, argument: value})


def test_tracking_has_a_fifth_of_the_false_alarms_at_a_delay_of_one_step() -> None:
    """Noise, dropouts, spurious and stuck beams; raw against tracked at 3 m."""
    numbers = tracking_against_raw(np.random.default_rng(0), drives=12)
    assert numbers["raw_false_alarm_rate"] > 0.05
    assert numbers["false_alarms_tracked_over_raw"] <= 0.2
    assert numbers["tracked_delay_mean_steps"] <= numbers["raw_delay_mean_steps"] + 1.0
    assert numbers["tracked_delay_max_steps"] <= 1.0
    assert numbers["tracked_miss_rate"] <= 0.05


def test_without_faults_the_simulated_clearance_is_the_smallest_range() -> None:
    """The bench's own truth is the truth."""
    clean = ScanFaults(noise=0.0, dropout=0.0, spurious=0.0, stuck=0)
    scans, truth = simulate_drive(np.random.default_rng(3), clean)
    assert (scans.min(axis=1) == truth).all()
    assert truth.min() < 5.0
