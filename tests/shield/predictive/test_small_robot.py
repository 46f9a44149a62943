"""Without lanes: a small robot with a 270 degree scanner among obstacles, any number of beams."""

import math

import numpy as np
import pytest

from shield import Assumptions, PredictiveFilter, ScannerGeometry, VehicleGeometry
from tests.shield.predictive.bodies import Array, Chase, Thing
from tests.shield.predictive.filters import robot_filter, shared_filter
from tests.shield.predictive.kinematic_world import (
    Driver,
    KinematicWorld,
    constant,
    drive,
)
from tests.shield.predictive.scenes import small_robot

SLOW = pytest.mark.slow
COUNTS = [45, 270, 1080, *(pytest.param(more, marks=SLOW) for more in (90, 360))]


def posts() -> list[Thing]:
    """Twelve boxes on a ring and six posts within."""
    ring = [(11.0 * math.cos(a), 11.0 * math.sin(a)) for a in np.linspace(0.0, 6.0, 12)]
    inside = [(6.0, 0.3), (1.0, 7.0), (-6.0, 2.0), (-2.0, -7.0), (8.0, -6.0), (7.0, 8.0)]
    boxes = [Thing(x, y, 1.0, 1.5, 0.3 * i) for i, (x, y) in enumerate(ring)]
    return boxes + [Thing(x, y, 0.6) for x, y in inside]


def held(seed: int) -> Driver:
    """Random commands, each held for a second."""
    commands = np.random.default_rng(seed).uniform([-0.4, 0.0], [0.4, 3.0], (30, 2))
    return lambda world, step: commands[step // 10 % 30]


@pytest.mark.parametrize("beams", COUNTS)
def test_a_robot_among_obstacles_touches_nothing(beams: int) -> None:
    """Straight on, in a circle, and at random; it gets somewhere, too."""
    for driver in (constant(0.0, 3.0), constant(0.4, 2.0), held(beams)):
        world = small_robot(beams, posts())
        world.rng = np.random.default_rng(beams)
        record = drive(world, robot_filter(beams), driver, 100)
        assert record.events == [] and record.distance > 1.5


def test_without_the_filter_the_same_drive_ends_in_a_contact() -> None:
    """The scene is one in which a robot can collide."""
    world, events = small_robot(45, posts()), []
    for step in range(60):
        speed = min(world.speed + world.limits.acceleration_step, 3.0)
        events += world.advance(np.array([0.0, speed]), step)
    assert any(event.at_fault for event in events)


@pytest.mark.parametrize("beams", [45, 180, 1080])
def test_people_around_a_robot(beams: int) -> None:
    """They walk at it; it stands when they arrive."""
    people = [Thing(9.0, 2.0, 0.5, motion=Chase()), Thing(6.0, -7.0, 0.5, motion=Chase())]
    record = drive(small_robot(beams, people), robot_filter(beams), constant(0.0, 3.0), 100)
    assert record.faults == []


@pytest.mark.parametrize(
    "beams", [45, 1080, *(pytest.param(more, marks=SLOW) for more in (90, 360))]
)
@pytest.mark.parametrize("distance", [12.0, 25.0])
def test_the_car_stops_before_a_wall_with_any_scanner(beams: int, distance: float) -> None:
    """A few beams or a thousand, half a turn or a whole one."""
    for view in (math.pi / 2.0, math.pi, 2.0 * math.pi):
        world = KinematicWorld([Thing(3.6 + distance, 1.75, 14.0, 1.0)], speed=6.0)
        world.scanner = ScannerGeometry(beams, view)
        shield = shared_filter(beams)
        if view != math.pi:
            shield = PredictiveFilter(
                world.limits, world.geometry, world.scanner, lanes=shield.world.lanes, deadline=1e6
            )
        record = drive(world, shield, constant(0.0, 8.0), 55)
        assert record.events == [] and record.speeds[-1] <= 1.0
        assert distance - 6.0 < record.distance < distance - 0.2


def test_on_a_free_plain_nothing_is_changed() -> None:
    """No lanes, nothing around: every admissible wish passes."""
    record = drive(small_robot(270, []), robot_filter(270), constant(0.2, 1.0), 40)
    assert not any(record.reasons[10:]) and record.speeds[-1] == 1.0


def test_a_robot_that_brakes_half_as_hard_keeps_further_away() -> None:
    """The filter counts on no more braking than the actuators have."""
    stops = []
    for braking in (6.0, 2.0):
        world = small_robot(270, [Thing(7.0, 0.0, 8.0, 0.5)])
        limits = type(world.limits)(
            max_speed=3.0, wheelbase=0.4, max_steering=0.4, max_deceleration=braking
        )
        world.limits = limits
        shield = PredictiveFilter(
            limits, world.geometry, world.scanner, Assumptions(), deadline=1e6
        )  # fmt: skip
        record = drive(world, shield, constant(0.0, 3.0), 60)
        assert record.events == []
        fast = [i for i, speed in enumerate(record.speeds) if speed > 2.0]
        stops.append(sum(record.speeds[: fast[-1] + 1]) * limits.dt)
    assert stops[1] < stops[0] - 0.2


@pytest.mark.parametrize("width", [1.6, 2.2])
def test_the_outline_of_the_car_counts(width: float) -> None:
    """A wider car stops before a post that a narrower one passes."""

    def passes(world: KinematicWorld, step: int) -> Array:
        return np.array([0.0, 4.0])

    world = KinematicWorld([Thing(15.0, -1.6, 0.8)], speed=4.0)
    world.geometry = VehicleGeometry(width=width)
    shield = PredictiveFilter(
        world.limits, world.geometry, world.scanner,
        Assumptions(person_acceleration=0.0, person_speed=0.0),
        lanes=shared_filter().world.lanes, deadline=1e6,
    )  # fmt: skip
    record = drive(world, shield, passes, 30)
    assert record.events == []
    straight = all(np.allclose(command, [0.0, 4.0]) for command in record.commands)
    assert straight == (width < 2.0)
