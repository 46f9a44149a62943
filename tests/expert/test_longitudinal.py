"""Speed set-points respect bends and gaps."""

import math

import pytest

from expert.longitudinal import CREEP_GAP, LongitudinalConfig, bend_speed, stopping_speed
from shield import LaneEstimate, LaneMeasurement, LaneTracker

CONFIG = LongitudinalConfig()


def bend(curvature: float) -> LaneEstimate:
    return LaneTracker(0.1).update(LaneMeasurement(0.0, 0.0, curvature, 0.0), 0.0, 0.0)


def test_free_straight_is_driven_at_cruise_speed() -> None:
    """Nothing ahead, no bend."""
    assert bend_speed(CONFIG, bend(0.0)) == CONFIG.cruise_speed
    assert stopping_speed(CONFIG, math.inf) == math.inf


def test_bends_bound_the_lateral_acceleration() -> None:
    """v^2 · kappa stays at the comfortable value in a tight bend."""
    lane = bend(0.05)
    speed = bend_speed(CONFIG, lane)
    assert speed**2 * lane.curvature == pytest.approx(CONFIG.lateral_acceleration, rel=1e-6)


def test_speed_falls_with_the_gap_and_ends_at_zero() -> None:
    """The set-point allows a stop with the planned deceleration; very close it is zero."""
    gaps = [40.0, 20.0, 10.0, 6.0, 4.5]
    speeds = [stopping_speed(CONFIG, gap) for gap in gaps]
    assert speeds == sorted(speeds, reverse=True)
    for gap, speed in zip(gaps, speeds, strict=True):
        assert speed**2 / (2.0 * CONFIG.deceleration) <= max(gap - CONFIG.standoff, 0.17) + 1e-9
    assert stopping_speed(CONFIG, CREEP_GAP) == 0.0
