import math

import numpy as np
import pytest
from numpy.typing import NDArray

from irl_dal.planner.rollout import (
    NO_TAIL,
    BrakingTail,
    EgoRollout,
    LanePose,
    RoadRollout,
    ego_gradient,
    ego_rollout,
    road_gradient,
    road_rollout,
)
from shield.vehicle import KinematicBicycle

Array = NDArray[np.float64]

WHEELBASE, DT = 2.7, 0.1
LANE = {"offset": 0.4, "heading": -0.1, "curvature": 0.02, "curvature_rate": 0.003}


def commands(seed: int, batch: int = 3, horizon: int = 8) -> Array:
    """Random commands, gentle enough for the tyres."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(1.0, 12.0, (batch, horizon))
    most = np.minimum(0.5, np.arctan(4.0 * WHEELBASE / speed**2))
    return np.stack([rng.uniform(-most, most), speed], axis=2)


def ego(values: Array) -> EgoRollout:
    """Roll out in the ego frame."""
    return ego_rollout(values, WHEELBASE, DT)


def road(values: Array, **changes: float) -> RoadRollout:
    """Roll out in the road frame."""
    return road_rollout(values, WHEELBASE, DT, LanePose(**{**LANE, **changes}))


@pytest.mark.parametrize("seed", range(5))
def test_ego_rollout_agrees_with_the_casadi_bicycle(seed: int) -> None:
    """The batched roll-out has the bicycle's heading exactly and its path to 5 mm."""
    values = commands(seed)
    mine = ego(values)
    bicycle = KinematicBicycle(WHEELBASE, DT)
    for index, chunk in enumerate(values):
        states = bicycle.rollout(np.zeros(3), chunk)
        np.testing.assert_allclose(mine.heading[index], states[:, 2], atol=1e-12)
        np.testing.assert_allclose(mine.x[index], states[:, 0], atol=5e-3)
        np.testing.assert_allclose(mine.y[index], states[:, 1], atol=5e-3)


def test_road_rollout_on_a_straight_lane_is_the_ego_rollout() -> None:
    """Without curvature, offset and heading are the turned and shifted ego roll-out."""
    values = commands(1)
    mine = road(values, curvature=0.0, curvature_rate=0.0)
    plain = ego(values)
    start = LANE["heading"]
    offset = LANE["offset"] + plain.x * math.sin(start) + plain.y * math.cos(start)
    np.testing.assert_allclose(mine.offset, offset, atol=1e-12)
    np.testing.assert_allclose(mine.heading, start + plain.heading, atol=1e-12)


def test_steering_along_the_curve_keeps_the_offset() -> None:
    """The steering atan(L kappa) on a lane of constant curvature keeps pose and heading."""
    kappa = 0.04
    values = np.full((1, 8, 2), (math.atan(WHEELBASE * kappa), 7.0))
    mine = road(values, offset=0.0, heading=0.0, curvature=kappa, curvature_rate=0.0)
    np.testing.assert_allclose(mine.offset, 0.0, atol=1e-12)
    np.testing.assert_allclose(mine.heading, 0.0, atol=1e-12)


def test_road_rollout_matches_the_geometry_of_a_circle() -> None:
    """Driving straight off a circular lane, the offset is the distance to the circle, to 2 cm."""
    radius, speed = 40.0, 8.0
    mine = road(
        np.full((1, 8, 2), (0.0, speed)),
        offset=0.0,
        heading=0.0,
        curvature=1.0 / radius,
        curvature_rate=0.0,
    )
    driven = speed * DT * np.arange(1, 9)
    outside = radius - np.hypot(driven, radius)  # the centre lies to the left
    np.testing.assert_allclose(mine.offset[0], outside, atol=0.02)


def test_curvature_rate_bends_the_lane() -> None:
    """On a clothoid the heading error is the integral of kappa_0 + kappa' s along the way."""
    values = np.full((1, 8, 2), (0.0, 10.0))
    mine = road(values)
    s = 10.0 * DT * np.arange(1, 9)
    turned = LANE["curvature"] * s + 0.5 * LANE["curvature_rate"] * s**2
    np.testing.assert_allclose(mine.heading[0], LANE["heading"] - turned, atol=1e-12)


def test_braking_tail_stops_where_a_braking_car_does() -> None:
    """After the plan the car drives v^2 / 2b along its last arc, in evenly spaced poses."""
    tail = BrakingTail(deceleration=4.0, points=4)
    values = np.full((1, 8, 2), (0.1, 8.0))
    rolled = ego_rollout(values, WHEELBASE, DT, tail)
    assert rolled.x.shape == (1, 12)
    np.testing.assert_allclose(rolled.x[:, :8], ego(values).x)
    turned = math.tan(0.1) / WHEELBASE * (8.0 * 0.8 + 8.0**2 / 8.0)
    assert float(rolled.heading[0, -1]) == pytest.approx(turned)
    np.testing.assert_allclose(np.diff(rolled.heading[0, 8:]), np.diff(rolled.heading[0, 8:])[0])


def test_others_brake_during_the_tail() -> None:
    """One that drives as fast gets as far; a slower one stops after v / 2b seconds of its speed."""
    tail = BrakingTail(deceleration=4.0, points=4)
    driven = tail.driven(8.0, np.array([8.0, 4.0, 0.0]))
    np.testing.assert_allclose(driven[:, 0] * 8.0, np.array([0.25, 0.5, 0.75, 1.0]) * 8.0)
    assert float(driven[-1, 1]) == pytest.approx(0.5)
    assert float(driven[-1, 2]) == 0.0


def finite_differences(function, values: Array) -> Array:  # type: ignore[no-untyped-def]
    """Central differences of a function of (B, H, 2) that returns a number."""
    gradient, step = np.zeros_like(values), 1e-6
    for index in np.ndindex(values.shape):
        moved = [values.copy(), values.copy()]
        moved[0][index] += step
        moved[1][index] -= step
        gradient[index] = (function(moved[0]) - function(moved[1])) / (2.0 * step)
    return gradient


@pytest.mark.parametrize("seed", range(3))
def test_gradients_against_finite_differences(seed: int) -> None:
    """Both pull-backs are the exact derivatives of a random function of all their outputs."""
    values = commands(seed, batch=2)
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(3, 2, 12))

    def of_ego(moved: Array, tail: BrakingTail = NO_TAIL) -> float:
        rolled = ego_rollout(moved, WHEELBASE, DT, tail)
        n = rolled.x.shape[1]
        return float((a[:, :n] * rolled.x + b[:, :n] * rolled.y + c[:, :n] * rolled.heading).sum())

    def of_road(moved: Array) -> float:
        rolled = road(moved)
        return float((a[:, :8] * rolled.offset + c[:, :8] * rolled.heading).sum())

    tail = BrakingTail(deceleration=4.0)
    with_tail = ego_rollout(values, WHEELBASE, DT, tail)
    for got, function in (
        (ego_gradient(ego(values), a[:, :8], b[:, :8], c[:, :8]), of_ego),
        (ego_gradient(with_tail, a, b, c), lambda moved: of_ego(moved, tail)),
        (road_gradient(road(values), a[:, :8], c[:, :8]), of_road),
    ):
        np.testing.assert_allclose(got, finite_differences(function, values), atol=2e-6)
