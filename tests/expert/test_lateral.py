"""The steering cascade is stable on the bicycle and turns the right way."""

import math

import numpy as np
import pytest

from expert.lateral import MAX_APPROACH, SHIFT_RATE, steer
from shield import ActuatorLimits, LaneEstimate, SetpointFollower

LIMITS = ActuatorLimits()
WHEELBASE = LIMITS.wheelbase


def at(offset: float, heading: float, curvature: float) -> LaneEstimate:
    """An estimate without an error."""
    return LaneEstimate(offset, heading, curvature, 0.0, 0.05, 0.0, valid=True)


def drive(speed: float, curvature: float, start: float, target: float, steps: int) -> np.ndarray:
    """Offset, heading error and steering (steps, 3) of the bicycle behind the follower."""
    follower, rows = SetpointFollower(LIMITS), []
    offset, heading = start, 0.0
    before = previous = np.array([math.atan(WHEELBASE * curvature), speed])
    for _ in range(steps):
        angle = steer(at(offset, heading, curvature), target, speed, float(previous[0]), LIMITS)
        before, previous = previous, follower.follow((angle, speed), previous, before)
        rows.append((offset, heading, float(previous[0])))
        for _ in range(10):
            bend = curvature * math.cos(heading) / (1.0 - curvature * offset)
            heading += 0.01 * speed * (math.tan(previous[0]) / WHEELBASE - bend)
            offset += 0.01 * speed * math.sin(heading)
    return np.array(rows)


@pytest.mark.parametrize("speed", [2.0, 5.0, 8.0, 9.0])
@pytest.mark.parametrize("curvature", [-0.02, 0.0, 0.03])
def test_converges_to_the_target(speed: float, curvature: float) -> None:
    """From 1.5 m beside it the bicycle arrives with little overshoot."""
    offsets, headings, _ = drive(speed, curvature, 1.5, 0.0, 150).T
    assert offsets.min() > -0.3
    assert abs(offsets[-1]) < 0.1
    assert abs(headings[-1]) < 0.02


@pytest.mark.parametrize("speed", [3.0, 5.0, 7.0, 9.0])
def test_a_change_of_lane_is_quick_and_comfortable(speed: float) -> None:
    """Across in 5 s, with no overshoot to speak of, and within the comfortable acceleration."""
    offsets, headings, steering = drive(speed, 0.0, 0.0, 3.5, 100).T
    late = np.abs(offsets - 3.5) > 0.5
    assert LIMITS.dt * np.flatnonzero(late)[-1] < 5.0
    assert offsets.max() < 3.6
    assert np.abs(headings).max() < MAX_APPROACH + 0.02
    assert speed * np.sin(headings).max() < SHIFT_RATE + 0.1
    assert (speed**2 * np.tan(np.abs(steering)) / WHEELBASE).max() < 1.8


def test_signs() -> None:
    """Left of the target steers right; heading left steers right; a left bend steers left."""
    assert steer(at(1.0, 0.0, 0.0), 0.0, 8.0, 0.0, LIMITS) < 0.0
    assert steer(at(0.0, 0.2, 0.0), 0.0, 8.0, 0.0, LIMITS) < 0.0
    assert steer(at(0.0, 0.0, 0.02), 0.0, 8.0, 0.0, LIMITS) > 0.0
    assert steer(at(0.0, 0.0, 0.0), 3.5, 8.0, 0.0, LIMITS) > 0.0


def test_the_way_back_of_the_wheels_counts() -> None:
    """With the wheels still turned in, the same state asks for less than with straight ones."""
    lane = at(1.0, -0.1, 0.0)
    straight = steer(lane, 0.0, 4.0, 0.0, LIMITS)
    turned = steer(lane, 0.0, 4.0, -0.4, LIMITS)
    assert turned > straight + 0.05


def test_approach_angle_is_bounded() -> None:
    """Far away the commanded heading saturates: the steering no longer grows."""
    far = [steer(at(e, 0.0, 0.0), 0.0, 2.0, 0.0, LIMITS) for e in (5.0, 6.0)]
    assert np.isclose(far[0], far[1])
