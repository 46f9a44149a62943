"""The state machine goes through its four modes and drives the real city."""

from functools import cache

import numpy as np
import pytest

from expert import ExpertConfig, FSMExpert, Mode
from irl_dal.envs import CityConfig, CityEnv
from shield import ActuatorLimits, LaneTracker


@cache
def episode(seed: int) -> tuple[dict[str, object], list[Mode], list[np.ndarray]]:
    """Drive an episode by the expert's commands: last info, modes, commands."""
    config = CityConfig()
    env = CityEnv(config)
    env.camera_on = False
    expert, tracker = FSMExpert(ExpertConfig(), env.limits), LaneTracker(env.limits.dt)
    observation, info = env.reset(seed=seed)
    command, modes, commands = np.array([0.0, config.initial_speed]), [], []
    over = False
    while not over:
        speed = float(observation["speed"][0])
        yaw_rate = speed * np.tan(command[0]) / env.limits.wheelbase
        lane = tracker.update(info["lane_measurement"], speed, yaw_rate)
        decision = expert.act(observation["lidar"], lane, speed, command)
        command = decision.command
        observation, _, terminated, truncated, info = env.execute(command)
        modes.append(decision.mode)
        commands.append(command)
        over = terminated or truncated
    env.close()
    return info, modes, commands


SLOW = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(501, 506)]


@pytest.mark.parametrize("seed", [500, *SLOW])
def test_reaches_the_goal(seed: int) -> None:
    """A whole drive in the default city, without touching anything."""
    info, modes, _ = episode(seed)
    assert info["success"]
    assert set(modes) == set(Mode)


def test_commands_are_slew_limited() -> None:
    """Successive commands differ by no more than the rates allow."""
    limits = ActuatorLimits()
    _, _, commands = episode(500)
    steps = np.diff(np.array(commands), axis=0)
    assert np.abs(steps[:, 0]).max() <= limits.max_steering_rate * limits.dt + 1e-12
    assert steps[:, 1].max() <= limits.max_acceleration * limits.dt + 1e-12
    assert -steps[:, 1].min() <= limits.max_deceleration * limits.dt + 1e-12


def test_approach_reaches_the_setpoint_at_full_rate() -> None:
    """A far set-point is approached by one rate step a row and then held."""
    expert = FSMExpert(ExpertConfig(), ActuatorLimits())
    rows = expert.approach(np.array([0.1, 3.0]), np.array([0.0, 3.0]), 4)
    assert rows[:, 0] == pytest.approx([0.06, 0.1, 0.1, 0.1])
    assert rows[:, 1] == pytest.approx([3.0, 3.0, 3.0, 3.0])


def test_nonsense_is_refused() -> None:
    """The error names the threshold and the value."""
    with pytest.raises(ValueError, match="`sight` must be positive.* Got -1.0"):
        ExpertConfig(sight=-1.0)
