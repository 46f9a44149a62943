"""The physical car follows its commands."""

from collections.abc import Iterator

import numpy as np
import pytest

from irl_dal.envs.vehicle import WHEELBASE, Vehicle
from irl_dal.envs.world import World


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
