"""Arbitrary scenes and drivers within the assumptions, as Hypothesis strategies."""

import math
from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st

from shield import ActuatorLimits, ScannerGeometry
from tests.shield.predictive.bodies import Array, Chase, Road, Roll, Thing, Walk
from tests.shield.predictive.kinematic_world import Driver, KinematicWorld

LIMITS = ActuatorLimits()
CAR_LENGTH, CAR_WIDTH = 4.5, 1.8
ONCOMING = (7.0, 10.5)  # [m] offsets of the oncoming lanes


@dataclass(frozen=True)
class Wishes:
    """Commands (n, 2), each held for some periods; over and over again."""

    commands: tuple[tuple[float, float], ...]
    holds: tuple[int, ...]

    def __call__(self, world: KinematicWorld, step: int) -> Array:
        """The command of a step."""
        place = step % sum(self.holds)
        for command, hold in zip(self.commands, self.holds, strict=True):
            place -= hold
            if place < 0:
                return np.array(command)
        raise AssertionError


def _between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


@st.composite
def drivers(draw: st.DrawFn, fastest: float = LIMITS.max_speed) -> Driver:
    """One to five wishes of any size, each held for up to three seconds."""
    count = draw(st.integers(1, 5))
    sharpest = LIMITS.max_steering
    steering = st.one_of(
        _between(-sharpest, sharpest),
        _between(-0.1, 0.1),
        _between(-0.03, 0.03),
        st.sampled_from([-sharpest, 0.0, sharpest]),
    )
    speed = st.one_of(
        _between(0.0, fastest), _between(0.4 * fastest, fastest), st.sampled_from([0.0, fastest])
    )
    wish = st.tuples(steering, speed)
    commands = tuple(draw(wish) for _ in range(count))
    holds = tuple(draw(st.integers(1, 30)) for _ in range(count))
    return Wishes(commands, holds)


@st.composite
def standing(draw: st.DrawFn, road: Road, first: float = 8.0) -> Thing:
    """A post, a barrel, a box or a parked car, on the road or beside it."""
    x, y, yaw = road.place(draw(_between(first, 60.0)), draw(_between(-6.0, 12.0)))
    shape = draw(st.sampled_from(["post", "box", "car"]))
    if shape == "post":
        return Thing(x, y, draw(_between(0.4, 1.2)))
    yaw += draw(_between(-math.pi, math.pi))
    if shape == "car":
        return Thing(x, y, CAR_WIDTH, CAR_LENGTH, yaw)
    return Thing(x, y, draw(_between(0.4, 3.0)), draw(_between(0.4, 6.0)), yaw)


@st.composite
def people(draw: st.DrawFn, road: Road, first: float = 10.0) -> Thing:
    """Somebody who walks here and there, or at the car."""
    x, y, _ = road.place(draw(_between(first, 50.0)), draw(_between(-8.0, 12.0)))
    if draw(st.integers(0, 3)) == 0:
        return Thing(x, y, 0.5, motion=Chase())
    pace = st.tuples(_between(-1.8, 1.8), _between(-1.8, 1.8)) | st.just((0.0, 0.0))
    targets = draw(st.lists(pace, min_size=1, max_size=4))
    return Thing(x, y, 0.5, motion=Walk(targets, draw(st.integers(3, 30))))


@st.composite
def vehicles(draw: st.DrawFn, road: Road, first: float = 14.0) -> Thing:
    """A slower car ahead that may brake at any time, or an oncoming one in its lane."""
    brake_at = draw(st.integers(0, 100) | st.just(10_000))
    if draw(st.booleans()):
        offset, speed = draw(st.sampled_from(road.lanes.centres)), draw(_between(0.0, 8.0))
        x, y, yaw = road.place(draw(_between(first, 45.0)), offset)
    else:
        offset, speed = draw(st.sampled_from(ONCOMING)), -draw(_between(2.0, 12.0))
        x, y, yaw = road.place(draw(_between(first, 90.0)), offset)
    motion = Roll(road, speed, offset, brake_at)
    velocity = speed * np.array([math.cos(yaw), math.sin(yaw)])
    return Thing(x, y, CAR_WIDTH, CAR_LENGTH, yaw, motion, velocity)


def _apart(things: list[Thing]) -> list[Thing]:
    """Without those that stand within others at first."""
    kept: list[Thing] = []
    for thing in things:
        size = thing.length or thing.width
        if all(math.hypot(thing.x - k.x, thing.y - k.y) > size + (k.length or 1.0) for k in kept):
            kept.append(thing)
    return kept


@st.composite
def roads(draw: st.DrawFn) -> KinematicWorld:
    """Two lanes with anything on them and beside them; the car stands, or drives at first."""
    road = Road(draw(st.just(0.0) | _between(-0.03, 0.03)))
    speed = draw(st.just(0.0) | _between(2.0, 8.0))
    first = 12.0 + speed * speed / 8.0 + speed
    still, walking = standing(road, first), people(road, first + 4.0)
    kind = st.one_of(still, still, walking, vehicles(road, first + 4.0))
    things = _apart(draw(st.lists(kind, max_size=6)))
    pose = road.place(0.0, draw(st.sampled_from(road.lanes.centres)))
    seed = draw(st.none() | st.integers(0, 1000))
    rng = None if seed is None else np.random.default_rng(seed)
    return KinematicWorld(things, road, pose, speed, rng=rng)


@st.composite
def yards(draw: st.DrawFn, beams: int = 270) -> KinematicWorld:
    """No lanes: things and people around a small robot with a 270 degree scanner."""
    kind = st.one_of(standing(Road(), 3.0), people(Road(), 5.0))
    things = draw(st.lists(kind, max_size=8))
    turned = draw(_between(-math.pi, math.pi))
    world = small_robot(beams, [])
    cos, sin = math.cos(turned), math.sin(turned)
    around = [
        replace(thing, x=cos * thing.x - sin * thing.y, y=sin * thing.x + cos * thing.y)
        for thing in things
    ]
    world.things = _apart(around)
    seed = draw(st.none() | st.integers(0, 1000))
    world.rng = None if seed is None else np.random.default_rng(seed)
    world.__post_init__()
    return world


def small_robot(beams: int, things: list[Thing]) -> KinematicWorld:
    """A robot of 0.7 m by 0.5 m with 3 m/s at most, on a free plain."""
    from shield import VehicleGeometry

    return KinematicWorld(
        things,
        None,
        limits=replace(LIMITS, max_speed=3.0, wheelbase=0.4, max_steering=0.4),
        geometry=VehicleGeometry(length=0.7, width=0.5, front_bumper=0.55),
        scanner=ScannerGeometry(beams, math.radians(270.0), 15.0, 0.5),
    )
