"""The road is smooth, reproducible, and its coordinates agree with each other."""

import numpy as np
import pytest

from irl_dal.envs.road import HALF_WIDTH, Road


@pytest.fixture(params=range(8))
def road(request: pytest.FixtureRequest) -> Road:
    return Road.generate(np.random.default_rng(request.param), 600.0)


def test_same_generator_same_road() -> None:
    """Two generators with one seed draw one road; another seed draws another one."""
    one, two, other = (Road.generate(np.random.default_rng(s), 250.0) for s in (1, 1, 2))
    assert np.array_equal(one.points, two.points)
    assert not np.array_equal(one.points, other.points)


def test_radius_is_kept(road: Road) -> None:
    """No bend is tighter than the smallest radius, and the road is not straight."""
    assert np.abs(road.curvature).max() <= 1.0 / 25.0 + 1e-12
    assert np.abs(road.curvature).max() > 1.0 / 200.0 - 1e-12


def test_locate_inverts_pose(road: Road) -> None:
    """A point placed at (s, d) is found at (s, d), with and without a hint."""
    for s in np.linspace(0.0, 600.0, 23):
        for d in (-6.0, -1.75, 0.0, 5.0):
            x, y, yaw = road.pose(float(s), d)
            found = road.locate(x, y)
            assert found.s == pytest.approx(s, abs=0.05)
            assert found.d == pytest.approx(d, abs=0.02)
            assert found.heading == pytest.approx(yaw, abs=0.01)
            assert road.locate(x, y, found.index + 3).index == found.index


def test_road_never_meets_itself(road: Road) -> None:
    """Points far apart along the road are far apart on the ground."""
    points, s = road.points[::4], road.s[::4]
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    far = np.abs(s[:, None] - s[None]) > 60.0
    assert distance[far].min() > 2.0 * HALF_WIDTH
