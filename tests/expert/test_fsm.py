"""The state machine goes through its four modes and drives the real city."""

from functools import cache

import numpy as np
import pytest

from expert import ExpertConfig, FSMExpert, Mode
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.road import LANES
from shield import ActuatorLimits, LaneTracker, SetpointFollower, World
from tests.shield.predictive.bodies import Road, Roll, Thing
from tests.shield.predictive.kinematic_world import KinematicWorld


@cache
def episode(seed: int) -> tuple[dict[str, object], list[Mode]]:
    """Drive an episode by the expert's set-points: last info and modes."""
    config = CityConfig()
    env = CityEnv(config)
    env.camera_on = False
    expert, tracker = FSMExpert(ExpertConfig(), env.limits), LaneTracker(env.limits.dt)
    world = World(env.limits.dt, config.scanner, config.vehicle, LANES)
    observation, info = env.reset(seed=seed)
    command, modes, over = np.array([0.0, config.initial_speed]), [], False
    before, follower = command, SetpointFollower(env.limits)
    while not over:
        speed = float(observation["speed"][0])
        yaw_rate = speed * np.tan(command[0]) / env.limits.wheelbase
        lane = tracker.update(info["lane_measurement"], speed, yaw_rate)
        world.update(observation["lidar"], speed, yaw_rate, lane)
        decision = expert.act(world, lane, command)
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


def overtake(theirs: float, speeds: list[float]) -> tuple[list[Mode], list[float]]:
    """Modes of an expert who is driven past a car, and how far their rears are behind its front.

    The car drives in the home lane with `theirs` [m/s], the own one beside it with `speeds` [m/s].
    """
    car = Thing(20.0, 0.0, 1.8, 4.5, motion=Roll(Road(), theirs, 0.0))
    scene = KinematicWorld([car], pose=(0.0, 3.5, 0.0), speed=speeds[0], understeer=0.0)
    world = World(0.1, scene.scanner, scene.geometry, LANES)
    expert, modes, behind = FSMExpert(ExpertConfig(), ActuatorLimits()), [], []
    for step, speed in enumerate(speeds):
        lane = scene.lane()
        assert lane is not None
        world.update(scene.scan(), scene.speed, 0.0, lane)
        modes.append(expert.act(world, lane, np.array([0.0, scene.speed])).mode)
        behind.append(car.x + 2.25 - (scene.pose[0] - scene.geometry.rear_overhang))
        scene.advance(np.array([0.0, speed]), step)
    return modes, behind


@pytest.mark.parametrize(("theirs", "ours"), [(0.0, 6.0), (2.0, 6.0), (4.5, 7.0)])
def test_what_is_beside_is_passed_before_going_back(theirs: float, ours: float) -> None:
    """The LiDAR does not see it then; a second later the car has gone back."""
    modes, behind = overtake(theirs, [ours] * 140)
    back = modes.index(Mode.RETURNING)
    # The lanes begin to overlap 0.7 s later.
    assert -3.0 < behind[back] - 0.7 * (ours - theirs) < -0.8


def test_a_car_beside_is_remembered_while_we_are_as_slow() -> None:
    """Driving along at its speed, for ten seconds, does not pass it; driving faster does."""
    modes, behind = overtake(3.0, [6.0] * 70 + [3.0] * 100 + [6.0] * 30)
    assert -4.0 < behind[70] < 4.0
    assert Mode.RETURNING not in modes[:170]
    assert Mode.RETURNING in modes[170:]
