"""Sensors agree with the geometry of the world."""

import numpy as np
import pytest

from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.road import HOME_LANE
from irl_dal.envs.vehicle import GEOMETRY


def test_beam_zero_is_at_the_right() -> None:
    """A wall on the right is seen by the first beams, one ahead by the middle ones."""
    env = CityEnv(CityConfig(difficulty="easy"))
    env.reset(seed=0)
    free = env.scene().scan
    state = env.scene().vehicle
    wall = env._world.box((2.0, 2.0, 2.0), (1.0, 0.0, 0.0))
    right = np.array([np.sin(state.yaw), -np.cos(state.yaw)])
    ahead = np.array([np.cos(state.yaw), np.sin(state.yaw)])
    for direction, beams in ((right, slice(0, 8)), (ahead, slice(86, 94))):
        at = np.array([state.x, state.y]) + GEOMETRY.front_bumper * ahead + 5.0 * direction
        env._world.move(wall, (float(at[0]), float(at[1]), 1.0), state.yaw)
        env._world.step(0.0083)
        scan = env._lidar.scan(state)
        assert scan[beams] == pytest.approx(4.0, abs=0.3)
        assert scan[150] == pytest.approx(free[150], abs=0.3)
    env.close()


def test_noise_and_dropouts_have_the_stated_size() -> None:
    """Readings scatter by `lidar_noise`; `lidar_dropout` of them read the full range."""
    config = CityConfig(lidar_noise=0.05, lidar_dropout=0.1)
    env = CityEnv(config)
    env.reset(seed=0)
    truth = np.full(180, 10.0)
    rng = np.random.default_rng(0)
    readings = np.stack([env._lidar.measure(truth, rng) for _ in range(200)])
    lost = readings == config.lidar_range
    assert lost.mean() == pytest.approx(0.1, abs=0.01)
    assert readings[~lost].std() == pytest.approx(0.05, rel=0.05)
    env.close()


def test_lane_measurement_is_the_truth_plus_noise() -> None:
    """Offset and heading scatter around the true ones; a clothoid describes the lane ahead."""
    env = CityEnv(CityConfig())
    env.reset(seed=4)
    road = env.scene().road
    rng = np.random.default_rng(0)
    for s in (10.0, 80.0, 150.0):
        x, y, yaw = road.pose(s, HOME_LANE + 0.4)
        env._vehicle.place(x, y, yaw + 0.05, 0.0)
        state, at = env._vehicle.state(), road.locate(x, y)
        seen = [env._lane_sensor.measure(state, at, rng) for _ in range(300)]
        offsets = np.array([m.lateral_offset for m in seen if m is not None])
        headings = np.array([m.heading_error for m in seen if m is not None])
        assert offsets.mean() == pytest.approx(0.4, abs=0.03)
        assert offsets.std() == pytest.approx(env.config.lane_offset_noise, rel=0.2)
        assert headings.mean() == pytest.approx(0.05, abs=0.02)
    env.close()
