"""The lane is tracked through gaps and outliers, and a lost lane is said to be lost."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import InvalidLimits, InvalidProblem, LaneGeometry, LaneMeasurement, LaneTracker
from tests.shield.strategies import NASTY
from tests.shield.tiers import two_tiers

DT = 0.1


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


@two_tiers(fast=200, motion=st.lists(st.tuples(NASTY, NASTY), min_size=1, max_size=6))
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


def test_unknown_motion_is_bridged() -> None:
    """NaN as speed or yaw rate: the last speed, and the lane's own bend."""
    tracker = LaneTracker(DT)
    for _ in range(10):
        tracker.update(sighting(0.0, 0.0, 0.01), 8.0, 0.08)
    estimate = tracker.update(None, math.nan, math.nan)
    assert estimate.heading_error == pytest.approx(0.0, abs=0.01)
    assert math.isfinite(estimate.offset_std)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("speed", (None, None, 0.0)),
        ("yaw_rate", (None, 0.0, "fast")),
        ("measurement", (0.1, 0.0, 0.0)),
        ("measurement", (LaneMeasurement(None, 0.0, 0.0, 0.0), 0.0, 0.0)),  # type: ignore[arg-type]
    ],
)
def test_what_is_not_a_number_raises(name: str, arguments: Any) -> None:
    """Naming the argument: types are mistakes of the caller, values are not."""
    with pytest.raises(InvalidProblem, match=f"`{name}`"):
        LaneTracker(DT).update(*arguments)


@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf])
def test_impossible_settings_raise(value: Any) -> None:
    """Naming the argument."""
    with pytest.raises(InvalidProblem, match="`dt`"):
        LaneTracker(value)
    with pytest.raises(InvalidProblem, match="`max_age`"):
        LaneTracker(DT, max_age=value)
    with pytest.raises(InvalidLimits, match="`width`"):
        LaneGeometry(value)
