"""The trackers follow, coast, reject, and never make a blind car confident."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import ClearanceTracker, InvalidProblem, LaneMeasurement, LaneTracker
from shield.bench.estimation import ScanFaults, simulate_drive, tracking_against_raw
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


@two_tiers(values=st.lists(st.lists(NASTY, min_size=12, max_size=12), min_size=1, max_size=6))
def test_any_scan_leaves_the_tracker_finite(values: list[list[float]]) -> None:
    """NaN, infinities and huge values never reach the state."""
    tracker = ClearanceTracker(DT)
    for scan in values:
        estimate = tracker.update(scan)
        assert 0.0 <= estimate.clearance <= 40.0
        assert math.isfinite(estimate.closing_speed)
        assert math.isfinite(estimate.std)


def sighting(offset: float, heading: float = 0.0, curvature: float = 0.0) -> LaneMeasurement:
    """Return a sighting with ordinary noise figures."""
    return LaneMeasurement(offset, heading, curvature, 0.0)


def test_the_lane_is_tracked_through_noise_and_motion(rng: np.random.Generator) -> None:
    """A car drifting to the left at 8 m/s in a bend; the estimate beats a single sighting."""
    tracker = LaneTracker(DT)
    offset, heading, errors = 0.0, 0.02, []
    for step in range(100):
        offset += 8.0 * heading * DT
        estimate = tracker.update(
            sighting(offset + rng.normal(0.0, 0.1), heading + rng.normal(0.0, 0.02), 0.01),
            8.0,
            8.0 * 0.01,
        )
        if step > 20:
            errors.append(estimate.lateral_offset - offset)
    assert np.std(errors) < 0.08
    assert estimate.heading_error == pytest.approx(heading, abs=0.02)
    assert estimate.curvature == pytest.approx(0.01, abs=0.003)


def test_a_lost_lane_is_extrapolated_grows_uncertain_and_expires() -> None:
    """The car goes on drifting in the model; the estimate is invalid after max_age."""
    tracker = LaneTracker(DT, max_age=0.25)
    for _ in range(20):
        before = tracker.update(sighting(0.5, 0.05), 10.0, 0.0)
    dark = [tracker.update(None, 10.0, 0.0) for _ in range(4)]
    assert dark[-1].lateral_offset - before.lateral_offset == pytest.approx(0.2, abs=0.05)
    assert [one.valid for one in dark] == [True, True, False, False]
    assert dark[-1].offset_std > before.offset_std
    assert not LaneTracker(DT).update(None, 5.0, 0.0).valid


@pytest.mark.parametrize(
    "bad",
    [
        LaneMeasurement(math.nan, 0.0, 0.0, 0.0),
        LaneMeasurement(0.0, math.inf, 0.0, 0.0),
        LaneMeasurement(0.0, 0.0, 0.0, 0.0, offset_std=math.nan),
        LaneMeasurement(0.0, 0.0, 0.0, 0.0, offset_std=0.0),
        LaneMeasurement(0.0, 0.0, 0.0, 0.0, heading_std=-1.0),
        LaneMeasurement(1e300, 0.0, 0.0, 0.0),
    ],
)
def test_malformed_sightings_count_as_missing(bad: LaneMeasurement) -> None:
    """They age the estimate and leave its values alone."""
    tracker, twin = LaneTracker(DT), LaneTracker(DT)
    for _ in range(5):
        tracker.update(sighting(0.3), 5.0, 0.0)
        twin.update(sighting(0.3), 5.0, 0.0)
    assert tracker.update(bad, 5.0, 0.0) == twin.update(None, 5.0, 0.0)


def test_a_missing_curvature_does_not_cost_the_sighting() -> None:
    """Offset and heading are used, the curvature is kept."""
    tracker = LaneTracker(DT)
    for _ in range(10):
        tracker.update(sighting(0.0, 0.0, 0.02), 5.0, 0.1)
    estimate = tracker.update(LaneMeasurement(0.1, 0.0, math.nan, math.nan), 5.0, 0.1)
    assert estimate.age == 0.0
    assert estimate.curvature == pytest.approx(0.02, abs=0.005)


def test_outliers_are_rejected_until_they_insist() -> None:
    """One sighting 3 m off is missing; five in a row mean that the filter was lost."""
    tracker = LaneTracker(DT)
    for _ in range(20):
        tracker.update(sighting(0.0), 5.0, 0.0)
    estimate = tracker.update(sighting(3.0), 5.0, 0.0)
    assert estimate.lateral_offset == pytest.approx(0.0, abs=0.1)
    assert estimate.age == pytest.approx(0.1)
    assert tracker.update(sighting(0.0), 5.0, 0.0).age == 0.0
    estimates = [tracker.update(sighting(3.0), 5.0, 0.0) for _ in range(5)]
    assert [one.age > 0.0 for one in estimates] == [True] * 4 + [False]
    assert estimates[-1].lateral_offset == pytest.approx(3.0, abs=0.2)


@two_tiers(motion=st.lists(st.tuples(NASTY, NASTY), min_size=1, max_size=6))
def test_any_motion_leaves_the_lane_tracker_finite(motion: list[tuple[float, float]]) -> None:
    """NaN, infinities and speeds of no vehicle never reach the state, and it recovers."""
    tracker = LaneTracker(DT)
    for speed, yaw_rate in motion:
        estimate = tracker.update(sighting(0.1), speed, yaw_rate)
        assert math.isfinite(estimate.lateral_offset)
        assert math.isfinite(estimate.offset_std)
    for _ in range(10):
        estimate = tracker.update(sighting(0.1), 5.0, 0.0)
    assert estimate.lateral_offset == pytest.approx(0.1, abs=0.1)


def test_what_is_not_a_number_raises() -> None:
    """Naming the argument: types are mistakes of the caller, values are not."""
    lane, clearance = LaneTracker(DT), ClearanceTracker(DT)
    with pytest.raises(InvalidProblem, match="`speed`.*None"):
        lane.update(None, None, 0.0)  # type: ignore[arg-type]
    with pytest.raises(InvalidProblem, match="`yaw_rate`.*'fast'"):
        lane.update(None, 0.0, "fast")  # type: ignore[arg-type]
    with pytest.raises(InvalidProblem, match="`measurement`.*LaneMeasurement"):
        lane.update(0.1, 0.0, 0.0)  # type: ignore[arg-type]
    with pytest.raises(InvalidProblem, match="`measurement`.*numbers"):
        lane.update(LaneMeasurement(None, 0.0, 0.0, 0.0), 0.0, 0.0)  # type: ignore[arg-type]
    with pytest.raises(InvalidProblem, match="`speed`.*'fast'"):
        clearance.update(np.ones(9), "fast")  # type: ignore[arg-type]
    with pytest.raises(InvalidProblem, match="`scan`.*numbers"):
        clearance.update("far")
    with pytest.raises(InvalidProblem, match="`dt`.*'often'"):
        ClearanceTracker("often")  # type: ignore[arg-type]


def test_unknown_motion_is_bridged() -> None:
    """NaN as speed or yaw rate: the last speed, and the lane's own bend."""
    tracker = LaneTracker(DT)
    for _ in range(10):
        tracker.update(sighting(0.0, 0.0, 0.01), 8.0, 0.08)
    estimate = tracker.update(None, math.nan, math.nan)
    assert estimate.heading_error == pytest.approx(0.0, abs=0.01)
    assert math.isfinite(estimate.offset_std)


@pytest.mark.parametrize("argument", ["max_range", "max_age"])
@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf])
def test_impossible_tracker_settings_raise(argument: str, value: Any) -> None:
    """Naming the argument."""
    with pytest.raises(InvalidProblem, match=f"`{argument}`"):
        ClearanceTracker(DT, **{argument: value})
    with pytest.raises(InvalidProblem, match="`dt`"):
        LaneTracker(value)


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
