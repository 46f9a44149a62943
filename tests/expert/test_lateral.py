"""The steering cascade is stable on the bicycle and turns the right way."""

import math

import numpy as np
import pytest

from expert.lateral import LateralConfig, steer
from shield import LaneEstimate, LaneMeasurement, LaneTracker

WHEELBASE = 2.7


def at(offset: float, heading: float, curvature: float) -> LaneEstimate:
    """A fresh estimate: the first measurement is believed."""
    return LaneTracker(0.1).update(LaneMeasurement(offset, heading, curvature, 0.0), 0.0, 0.0)


@pytest.mark.parametrize("speed", [2.0, 5.0, 8.0, 11.0])
@pytest.mark.parametrize("curvature", [-0.02, 0.0, 0.03])
def test_converges_to_the_target(speed: float, curvature: float) -> None:
    """From 1.5 m beside it the bicycle arrives within 0.1 m and stays, at any speed."""
    offset, heading = 1.5, 0.0
    for _ in range(150):
        steering = steer(
            LateralConfig(), at(offset, heading, curvature), 0.0, 0.0, speed, WHEELBASE
        )
        steering = max(-0.5, min(0.5, steering))
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
    assert abs(offset) < 0.1
    assert abs(heading) < 0.02


def test_signs() -> None:
    """Left of the target steers right; heading left steers right; a left bend steers left."""
    config = LateralConfig()
    assert steer(config, at(1.0, 0.0, 0.0), 0.0, 0.0, 8.0, WHEELBASE) < 0.0
    assert steer(config, at(0.0, 0.2, 0.0), 0.0, 0.0, 8.0, WHEELBASE) < 0.0
    assert steer(config, at(0.0, 0.0, 0.02), 0.0, 0.0, 8.0, WHEELBASE) > 0.0
    assert steer(config, at(0.0, 0.0, 0.0), 3.5, 0.0, 8.0, WHEELBASE) > 0.0
    assert steer(config, at(0.0, 0.0, 0.0), 0.0, 1.0, 8.0, WHEELBASE) > 0.0


def test_zero_gain_is_refused() -> None:
    """The error names the gain and the value."""
    with pytest.raises(ValueError, match="`heading_time` must be positive. Got 0.0"):
        LateralConfig(heading_time=0.0)


def test_approach_angle_is_bounded() -> None:
    """Far away the commanded heading saturates: the steering no longer grows."""
    far = [steer(LateralConfig(), at(e, 0.0, 0.0), 0.0, 0.0, 2.0, WHEELBASE) for e in (5.0, 6.0)]
    assert np.isclose(far[0], far[1])
