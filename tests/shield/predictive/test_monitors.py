"""Every assumption that can be seen to be broken raises its flag, and hardly ever without cause."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from shield import Assumptions, LaneEstimate, PredictiveFilter
from tests.shield.predictive.bodies import Chase, Roll, Thing, Walk
from tests.shield.predictive.filters import TIME, robot_filter, shared_filter
from tests.shield.predictive.kinematic_world import KinematicWorld
from tests.shield.predictive.scenes import small_robot


@dataclass
class Glide:
    """A velocity [m/s] that never changes, whatever it belongs to."""

    x: float
    y: float

    def advance(self, thing: Thing, car: Thing, dt: float) -> tuple[float, float, float]:
        """One period."""
        return thing.x + self.x * dt, thing.y + self.y * dt, thing.yaw


@dataclass
class Readings:
    """What the sensors say, to be spoilt."""

    scan: np.ndarray
    speed: float
    yaw_rate: float
    lane: LaneEstimate | None
    age: float = 0.0


Spoil = Callable[[Readings, int], Any]


def flags(
    world: KinematicWorld,
    shield: PredictiveFilter,
    steps: int,
    spoil: Spoil = lambda readings, step: None,
    wish: tuple[float, float] = (0.0, 5.0),
) -> list[tuple[str, ...]]:
    """Those of every step of a drive."""
    raised = []
    shield.reset([world.steering, world.speed])
    for step in range(steps):
        now = Readings(world.scan(), world.speed, world.yaw_rate, world.lane())
        spoil(now, step)
        shield.update(now.scan, now.speed, now.yaw_rate, now.lane, now.age)
        certificate = shield.filter(wish)
        raised.append(certificate.flags)
        world.advance(certificate.safe_action, step)
    return raised


def named(raised: list[tuple[str, ...]]) -> set[str]:
    """All that were raised."""
    return {flag for of_step in raised for flag in of_step}


def on_the_road() -> list[Thing]:
    """Parked, driving, oncoming and walking ones that keep the assumptions."""
    world = KinematicWorld([])
    assert (road := world.road) is not None
    ahead = Roll(road, 4.0, 0.0, 60)
    oncoming = Roll(road, -8.0, 7.0)
    return [
        Thing(45.0, 3.4, 1.8, 4.5),
        Thing(20.0, 0.0, 1.8, 4.5, motion=ahead, velocity=np.array([4.0, 0.0])),
        Thing(80.0, 7.0, 1.8, 4.5, math.pi, oncoming, np.array([-8.0, 0.0])),
        Thing(30.0, -4.0, 0.5, motion=Walk([(0.0, 1.5), (0.5, -1.0)])),
        Thing(25.0, 9.0, 0.5, motion=Chase()),
    ]


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(more, marks=pytest.mark.slow) for more in (2, 3))]
)
def test_nothing_is_raised_while_everything_holds(seed: int) -> None:
    """With noise, among all that moves as it may: in less than one step of a hundred."""
    world = KinematicWorld(on_the_road(), rng=np.random.default_rng(seed), speed=5.0)
    raised = flags(world, shared_filter(), 120, wish=(0.0, 8.0))
    people = [Thing(6.0, 3.0, 0.5, motion=Walk([(0.2, 1.2)])), Thing(5.0, -4.0, 1.0)]
    robot = small_robot(270, people)
    robot.rng = np.random.default_rng(seed)
    raised += flags(robot, robot_filter(270), 80, wish=(0.1, 1.5))
    assert sum(map(bool, raised)) <= 2, named(raised)


def test_a1_a_runner_is_seen_on_lanes_and_without() -> None:
    """Faster than any person may be; a walker is not."""
    for pace, expected in ((4.0, True), (1.8, False)):
        runner = Thing(12.0, -8.0, 0.5, motion=Glide(0.0, pace))
        raised = flags(KinematicWorld([runner]), shared_filter(), 40, wish=(0.0, 0.0))
        assert ("A1: faster than assumed" in named(raised)) == expected
        runner = Thing(8.0, -8.0, 0.5, motion=Glide(-0.3 * pace, 0.9 * pace))
        raised = flags(small_robot(270, [runner]), robot_filter(270), 40, wish=(0.0, 0.0))
        assert ("A1: faster than assumed" in named(raised)) == expected


def test_a1_on_level_p1_nothing_is_faster_than_objects_may_be() -> None:
    """A car at 6 m/s in a parking lot."""
    car = Thing(12.0, -9.0, 1.8, 3.0, 0.5 * math.pi, Glide(0.0, 6.0))
    robot = small_robot(270, [car])
    shield = PredictiveFilter(
        robot.limits, robot.geometry, robot.scanner, Assumptions(level="P1"), deadline=TIME
    )
    assert "A1: faster than assumed" in named(flags(robot, shield, 40, wish=(0.0, 0.0)))


@pytest.mark.parametrize(
    ("way", "place", "flag"),
    [
        ((0.0, 2.5), (14.0, -5.0), "A1: a vehicle leaves its lane"),
        ((-5.0, 0.0), (35.0, 1.0), "A1: a vehicle comes the wrong way"),
    ],
)
def test_a1_a_vehicle_that_breaks_the_rules(
    way: tuple[float, float], place: tuple[float, float], flag: str
) -> None:
    """It slides across the own lanes, or reverses at the car."""
    thing = Thing(*place, 1.8, 4.5, 0.0, Glide(*way))
    assert flag in named(flags(KinematicWorld([thing]), shared_filter(), 60, wish=(0.0, 0.0)))


def spoilt(**values: Any) -> Spoil:
    """Other readings from step 20 on: values, or functions of the true ones."""

    def spoil(readings: Readings, step: int) -> None:
        for name, value in values.items() if step >= 20 else ():
            true = getattr(readings, name)
            setattr(readings, name, value(true) if callable(value) else value)

    return spoil


def noisy(scan: np.ndarray) -> np.ndarray:
    """A deviation of twice the largest error."""
    return np.maximum(scan + np.random.default_rng(0).normal(0.0, 0.2, scan.shape), 0.05)


def half_blind(scan: np.ndarray) -> np.ndarray:
    """Two beams of three give nothing, in one block."""
    return np.where(np.arange(len(scan)) < len(scan) * 2 // 3, np.nan, scan)


@pytest.mark.parametrize(
    ("values", "flag"),
    [
        ({"scan": noisy}, "A3: noisier than assumed"),
        ({"scan": half_blind}, "A4: scanner blind"),
        ({"age": 0.2}, "A5: late scan"),
        ({"age": math.nan}, "A5: late scan"),
        ({"yaw_rate": 0.4}, "A6: turns otherwise than assumed"),
        ({"speed": math.nan}, "A7: speed or yaw rate is no number"),
        ({"yaw_rate": math.inf}, "A7: speed or yaw rate is no number"),
        ({"speed": lambda speed: speed + 3.0}, "A7: the speed jumps"),
        ({"lane": None}, "A9: lane lost"),
        (
            {"lane": lambda lane: replace(lane, lateral_offset=lane.lateral_offset + 0.8)},
            "A9: the lane estimate jumps",
        ),
        ({"lane": lambda lane: replace(lane, age=0.6)}, "A9: the lane is not seen"),
        ({"lane": lambda lane: replace(lane, heading_error=0.6)}, "A9: the lane is out of view"),
    ],
)
def test_what_the_sensors_say_raises_a_flag(values: dict[str, Any], flag: str) -> None:
    """From the step on at which it is wrong, and not before."""
    hedges = [Thing(30.0, side, 80.0, 0.5, 0.5 * math.pi) for side in (-6.0, 12.0)]
    world = KinematicWorld(hedges, speed=5.0, rng=np.random.default_rng(0))
    raised = flags(world, shared_filter(), 24, spoilt(**values))
    assert named(raised[:20]) == set() and flag in named(raised[20:])


def test_a3_a_hit_inside_the_own_body() -> None:
    """The scanner sees a part of the robot."""

    def inside(scan: np.ndarray) -> np.ndarray:
        angles = np.abs(robot_filter(270).world.scanner.angles)
        return np.where(np.abs(angles - 2.1) < 0.1, 0.15, scan)

    raised = flags(small_robot(270, []), robot_filter(270), 22, spoilt(scan=inside))
    assert "A3: a hit inside the own body" in named(raised[20:]) - named(raised[:20])


def test_a5_a_scan_that_repeats_itself() -> None:
    """As the world says."""
    first: list[np.ndarray] = []

    def frozen(scan: np.ndarray) -> np.ndarray:
        first.append(scan)
        return first[0]

    world = KinematicWorld([Thing(30.0, -4.0, 1.8, 4.5)], speed=5.0)
    world.rng = np.random.default_rng(0)
    assert "A5: scanner frozen" in named(flags(world, shared_filter(), 30, spoilt(scan=frozen)))


def test_a6_a_car_that_brakes_less() -> None:
    """It loses 2 m/s² where 6 are assumed; one that brakes as assumed raises nothing."""
    for braking, expected in ((2.0, True), (6.0, False)):
        speed, raised, shield = 8.0, [], shared_filter()
        shield.reset([0.0, speed])
        world = KinematicWorld([], speed=speed)
        for _ in range(10):
            shield.update(world.scan(), speed, 0.0, world.lane())
            certificate = shield.filter([0.0, 0.0])
            raised.append(certificate.flags)
            speed = max(float(certificate.safe_action[1]), speed - braking * shield.limits.dt)
        assert ("A6: brakes less than assumed" in named(raised)) == expected


def test_a10_a_first_state_that_is_not_certified() -> None:
    """At 10 m/s before a wall."""
    wall = Thing(9.0, 1.75, 14.0, 1.0)
    raised = flags(KinematicWorld([wall], speed=10.0), shared_filter(), 1)
    assert "A10: moves, and nothing is certified" in named(raised)


def test_a_reset_forgets_the_last_reading() -> None:
    """The speed of another drive is no jump."""
    shield = shared_filter()
    flags(KinematicWorld([], speed=8.0), shield, 3)
    assert named(flags(KinematicWorld([], speed=0.0), shield, 3)) == set()


def test_filtering_twice_repeats_the_flags() -> None:
    """They belong to the reading."""
    shield, world = shared_filter(), KinematicWorld([], speed=5.0)
    flags(world, shield, 5)
    shield.update(world.scan(), math.nan, 0.0, world.lane())
    first, second = shield.filter([0.0, 5.0]), shield.filter([0.0, 5.0])
    assert first.flags == second.flags == ("A7: speed or yaw rate is no number",)
