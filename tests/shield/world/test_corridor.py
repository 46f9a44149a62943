"""Points beside a lane that bends ever more are where they are."""

import math

import numpy as np
import pytest

from shield import LaneEstimate, LaneGeometry
from shield.world import Corridor

OFFSET, HEADING = 0.4, 0.1


@pytest.mark.parametrize("curvature", [-0.02, 0.0, 0.02])
@pytest.mark.parametrize("rate", [-0.001, 0.0, 0.001])
def test_points_beside_a_clothoid_are_located(curvature: float, rate: float) -> None:
    """Up to 20 m ahead, in both lanes, by a car aside of its centre and askew: within 0.3 m."""
    estimate = LaneEstimate(OFFSET, HEADING, curvature, rate, 0.02, 0.0, True)
    road = Corridor.around(estimate, LaneGeometry())
    assert road is not None
    step = 0.01
    along = np.arange(0.5 * step, 20.0, step)
    angle = curvature * along + 0.5 * rate * along**2
    centre = np.cumsum(step * np.stack([np.cos(angle), np.sin(angle)]), axis=1)
    for aside in (0.0, 3.5):
        x, y = centre + aside * np.stack([-np.sin(angle), np.cos(angle)])
        cos, sin = math.cos(HEADING), math.sin(HEADING)
        points = np.stack([cos * x + sin * (y - OFFSET), cos * (y - OFFSET) - sin * x], axis=1)
        s, d = road.locate(points)
        assert s == pytest.approx(along, abs=0.4) and d == pytest.approx(aside, abs=0.3)
