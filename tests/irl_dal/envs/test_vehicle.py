"""The physical car follows its commands."""

from collections.abc import Iterator

import numpy as np
import pytest

from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.vehicle import WHEELBASE, Vehicle
from irl_dal.envs.world import MAX_PHYSICS_STEP, World
from shield import ActuatorLimits


@pytest.fixture
def world() -> Iterator[World]:
    world = World()
    world.clear()
    yield world
    world.close()


def test_speed_follows_the_command(world: World) -> None:
    """A ramp within the motors' power is followed to 0.1 m/s; a standing car stays put."""
    car = Vehicle(world)
    car.place(0.0, 0.0, 0.0, 0.0)
    for speed in np.arange(0.3, 8.01, 0.3):
        car.drive(0.0, float(speed))
        world.step(0.1)
        assert car.state().speed == pytest.approx(speed, abs=0.1)
    for _ in range(40):
        car.drive(0.0, 0.0)
        world.step(0.1)
    still = car.state()
    world.step(1.0)
    assert car.state().x == pytest.approx(still.x, abs=0.01)


def test_braking_is_bounded_by_the_motors(world: World) -> None:
    """An impossible jump of the speed command takes physical time."""
    car = Vehicle(world)
    car.place(0.0, 0.0, 0.0, 8.0)
    car.drive(0.0, 0.0)
    world.step(0.5)
    assert car.state().speed > 3.0


@pytest.mark.parametrize("steering", [0.1, -0.25])
def test_turns_like_a_bicycle(world: World, steering: float) -> None:
    """Within 4 m/s^2 the yaw rate is v tan(delta)/L to 2 %, positive to the left."""
    car = Vehicle(world)
    car.place(0.0, 0.0, 0.0, 5.0)
    for _ in range(15):
        car.drive(steering, 5.0)
        world.step(0.1)
    state = car.state()
    assert state.yaw_rate == pytest.approx(state.speed * np.tan(steering) / WHEELBASE, rel=0.02)
    assert abs(state.lateral_speed) < 0.05


def test_grip_ends(world: World) -> None:
    """Far beyond the lateral bound the car no longer follows: the bound has a physical meaning."""
    car = Vehicle(world)
    car.place(0.0, 0.0, 0.0, 12.0)
    for _ in range(15):
        car.drive(0.45, 12.0)
        world.step(0.1)
    state = car.state()
    assert abs(state.yaw_rate) < 0.8 * 12.0 * np.tan(0.45) / WHEELBASE


PERIODS = (0.1, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.0125, 0.01, 0.007, 1.0 / 30.0, 0.3)


@pytest.mark.parametrize("dt", PERIODS)
def test_physics_lasts_as_long_as_the_control_period(dt: float) -> None:
    """Two seconds straight on: the distance is the speed times the time, whatever `dt`."""
    env = CityEnv(
        CityConfig(lane_sensor="odometry", difficulty="easy", initial_speed=8.0),
        ActuatorLimits(dt=dt),
    )
    env.camera_on = False
    _, info = env.reset(seed=3)
    start, speeds = info["progress"], []
    for _ in range(round(2.0 / dt)):
        info = env.execute(np.array([0.0, 8.0]))[-1]
        speeds.append(info["speed"])
    env.close()
    assert info["progress"] - start == pytest.approx(sum(speeds) * dt, rel=0.01)
    assert np.mean(speeds) == pytest.approx(8.0, abs=0.1)


def fall(world: World, dt: float, count: int) -> float:
    """How far a car falls freely in `count` periods of `dt` [m]."""
    world.clear()
    car = Vehicle(world)
    world.move(car.body, (0.0, 0.0, 500.0), 0.0)
    for _ in range(count):
        world.step(dt)
    return 500.0 - float(world.bullet.getBasePositionAndOrientation(car.body)[0][2])


@pytest.mark.parametrize("dt", PERIODS)
def test_a_fall_takes_its_time(dt: float, world: World) -> None:
    """After 1.2 s, in whatever periods, the same height is left, to the integration's error."""
    count = round(1.2 / dt)
    expected = fall(world, MAX_PHYSICS_STEP, 96) * (count * dt / 1.2) ** 2
    assert fall(world, dt, count) == pytest.approx(expected, rel=1.5 * MAX_PHYSICS_STEP)


@pytest.mark.parametrize("wheelbase", [2.2, 3.2])
def test_the_wheelbase_is_the_limits_s(wheelbase: float, world: World) -> None:
    """The car turns as a bicycle of the asked wheelbase does."""
    car = Vehicle(world, wheelbase)
    car.place(0.0, 0.0, 0.0, 5.0)
    for _ in range(15):
        car.drive(0.1, 5.0)
        world.step(0.1)
    state = car.state()
    assert state.yaw_rate == pytest.approx(state.speed * np.tan(0.1) / wheelbase, rel=0.02)


def test_the_city_hands_the_wheelbase_on() -> None:
    """One value for shield and car; an axle before the bumper is refused."""
    rates = {}
    for wheelbase in (2.7, 3.2):
        config = CityConfig(lane_sensor="odometry")
        env = CityEnv(config, ActuatorLimits(wheelbase=wheelbase))
        env.camera_on = False
        env.reset(seed=0)
        for _ in range(15):
            env.execute(np.array([0.05, 5.0]))
        rates[wheelbase] = env.scene().vehicle.yaw_rate / env.scene().vehicle.speed
        env.close()
    assert rates[2.7] / rates[3.2] == pytest.approx(3.2 / 2.7, rel=0.02)
    env = CityEnv(limits=ActuatorLimits(wheelbase=3.9))
    with pytest.raises(ValueError, match="`wheelbase`.*3.9"):
        env.reset(seed=0)
    env.close()
