"""The state machine goes through its four modes and drives the real city."""

from functools import cache

import numpy as np
import pytest

from expert import ExpertConfig, FSMExpert, Mode
from irl_dal.envs import CityConfig, CityEnv
from shield import LaneTracker, SetpointFollower


@cache
def episode(seed: int) -> tuple[dict[str, object], list[Mode]]:
    """Drive an episode by the expert's set-points: last info and modes."""
    config = CityConfig()
    env = CityEnv(config)
    env.camera_on = False
    expert, tracker = FSMExpert(ExpertConfig(), env.limits), LaneTracker(env.limits.dt)
    observation, info = env.reset(seed=seed)
    command, modes, over = np.array([0.0, config.initial_speed]), [], False
    before, follower = command, SetpointFollower(env.limits)
    while not over:
        speed = float(observation["speed"][0])
        yaw_rate = speed * np.tan(command[0]) / env.limits.wheelbase
        lane = tracker.update(info["lane_measurement"], speed, yaw_rate)
        decision = expert.act(observation["lidar"], lane, speed, command)
        before, command = command, follower.follow(decision.setpoint, command, before)
        observation, _, terminated, truncated, info = env.execute(command)
        modes.append(decision.mode)
        over = terminated or truncated
    env.close()
    return info, modes


SLOW = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(501, 506)]


@pytest.mark.parametrize("seed", [500, *SLOW])
def test_reaches_the_goal(seed: int) -> None:
    """A whole drive in the default city, without touching anything."""
    info, modes = episode(seed)
    assert info["success"]
    assert set(modes) == set(Mode)


def test_nonsense_is_refused() -> None:
    """The error names the threshold and the value."""
    with pytest.raises(ValueError, match="`sight` must be positive.* Got -1.0"):
        ExpertConfig(sight=-1.0)
