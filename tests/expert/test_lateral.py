"""The steering cascade is stable on the bicycle and turns the right way."""

import math

import numpy as np
import pytest

from expert.lateral import steer
from shield import ActuatorLimits, LaneEstimate, LaneMeasurement, LaneTracker

LIMITS = ActuatorLimits()
WHEELBASE = LIMITS.wheelbase


def at(offset: float, heading: float, curvature: float) -> LaneEstimate:
    """A fresh estimate: the first measurement is believed."""
    return LaneTracker(0.1).update(LaneMeasurement(offset, heading, curvature, 0.0), 0.0, 0.0)


@pytest.mark.parametrize("speed", [2.0, 5.0, 8.0, 11.0])
@pytest.mark.parametrize("curvature", [-0.02, 0.0, 0.03])
def test_converges_to_the_target(speed: float, curvature: float) -> None:
    """From 1.5 m beside it, with a servo of its rate, the bicycle arrives with little overshoot."""
    offset, heading, steering, offsets = 1.5, 0.0, 0.0, []
    step = LIMITS.max_steering_rate * LIMITS.dt
    for _ in range(150):
        lane = at(offset, heading, curvature)
        target = steer(lane, (0.0, 0.0, 0.0), speed, steering, LIMITS)
        steering = max(steering - step, min(steering + step, max(-0.5, min(0.5, target))))
        offsets.append(offset)
        for _ in range(10):
            heading += (
                0.01
                * speed
                * (
                    math.tan(steering) / WHEELBASE
                    - curvature * math.cos(heading) / (1.0 - curvature * offset)
                )
            )
            offset += 0.01 * speed * math.sin(heading)
    assert min(offsets) > -0.3
    assert abs(offset) < 0.1
    assert abs(heading) < 0.02


def test_signs() -> None:
    """Left of the target steers right; heading left steers right; a left bend steers left."""
    assert steer(at(1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 8.0, 0.0, LIMITS) < 0.0
    assert steer(at(0.0, 0.2, 0.0), (0.0, 0.0, 0.0), 8.0, 0.0, LIMITS) < 0.0
    assert steer(at(0.0, 0.0, 0.02), (0.0, 0.0, 0.0), 8.0, 0.0, LIMITS) > 0.0
    assert steer(at(0.0, 0.0, 0.0), (3.5, 0.0, 0.0), 8.0, 0.0, LIMITS) > 0.0
    assert steer(at(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 8.0, 0.0, LIMITS) > 0.0
    assert steer(at(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 8.0, 0.0, LIMITS) > 0.0


def test_the_way_back_of_the_wheels_counts() -> None:
    """With the wheels still turned in, the same state asks for less than with straight ones."""
    lane = at(1.0, -0.1, 0.0)
    straight = steer(lane, (0.0, 0.0, 0.0), 4.0, 0.0, LIMITS)
    turned = steer(lane, (0.0, 0.0, 0.0), 4.0, -0.4, LIMITS)
    assert turned > straight + 0.05


def test_approach_angle_is_bounded() -> None:
    """Far away the commanded heading saturates: the steering no longer grows."""
    far = [steer(at(e, 0.0, 0.0), (0.0, 0.0, 0.0), 2.0, 0.0, LIMITS) for e in (5.0, 6.0)]
    assert np.isclose(far[0], far[1])
