"""What stands and moves in the kinematic world: discs and rectangles, and how they move."""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from shield.estimation.lane import LaneGeometry

Array = NDArray[np.float64]
WALK_ACCELERATION = 0.9  # [m/s²] below what the assumptions grant a person
WALK_SPEED = 1.8  # [m/s] the same


@dataclass(frozen=True)
class Road:
    """Two lanes of constant curvature [1/m]; the first one's centre leaves the origin along x."""

    curvature: float = 0.0
    lanes: LaneGeometry = field(default_factory=LaneGeometry)

    def place(self, s: float, d: float) -> tuple[float, float, float]:
        """Point [m], [m] and direction [rad] at a distance along the lane and an offset."""
        if abs(self.curvature) < 1e-9:
            return s, d, 0.0
        angle, radius = self.curvature * s, 1.0 / self.curvature
        away = radius - d
        return away * math.sin(angle), radius - away * math.cos(angle), angle

    def locate(self, points: Array) -> tuple[Array, Array]:
        """Distances along the lane and offsets (n,) [m] of points (n, 2)."""
        if abs(self.curvature) < 1e-9:
            return points[:, 0], points[:, 1]
        x, y = self.curvature * points[:, 0], 1.0 - self.curvature * points[:, 1]
        return np.arctan2(x, y) / self.curvature, (1.0 - np.hypot(x, y)) / self.curvature


class Motion(Protocol):
    """How a thing moves on by one period."""

    def advance(self, thing: "Thing", car: "Thing", dt: float) -> tuple[float, float, float]:
        """Its next pose."""
        ...


@dataclass
class Thing:
    """A disc of diameter `width`, or a rectangle with a `length`; its pose is that of its middle.

    Lengths in [m]; `yaw` [rad]; `velocity` [m/s].
    """

    x: float
    y: float
    width: float
    length: float | None = None
    yaw: float = 0.0
    motion: Motion | None = None
    velocity: Array = field(default_factory=lambda: np.zeros(2))

    def next_pose(self, car: "Thing", dt: float) -> tuple[float, float, float]:
        """Where it is one period later."""
        if self.motion is None:
            return self.x, self.y, self.yaw
        return self.motion.advance(self, car, dt)

    def moved(self, pose: tuple[float, float, float]) -> "Thing":
        """The same outline elsewhere."""
        x, y, yaw = pose
        return Thing(x, y, self.width, self.length, yaw)

    def corners(self) -> Array:
        """Of a rectangle (4, 2), counter-clockwise."""
        assert self.length is not None
        ahead, aside = 0.5 * self.length, 0.5 * self.width
        local = np.array([[ahead, aside], [-ahead, aside], [-ahead, -aside], [ahead, -aside]])
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return np.asarray(local @ np.array([[cos, sin], [-sin, cos]]) + [self.x, self.y])

    def touches(self, other: "Thing") -> bool:
        """Whether this rectangle and the other thing share a point, exactly."""
        assert self.length is not None
        if other.length is None:
            dx, dy = other.x - self.x, other.y - self.y
            cos, sin = math.cos(self.yaw), math.sin(self.yaw)
            ahead = max(abs(cos * dx + sin * dy) - 0.5 * self.length, 0.0)
            aside = max(abs(cos * dy - sin * dx) - 0.5 * self.width, 0.0)
            return math.hypot(ahead, aside) <= 0.5 * other.width
        mine, theirs = self.corners(), other.corners()
        for yaw in (self.yaw, other.yaw):
            for axis in ((math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))):
                a, b = mine @ axis, theirs @ axis
                if a.max() < b.min() or b.max() < a.min():
                    return False
        return True


@dataclass
class Walk:
    """A person: towards one velocity after the other, each for `hold` periods.

    Velocities are cut to `WALK_SPEED` and reached with `WALK_ACCELERATION`.
    """

    velocities: list[tuple[float, float]]
    hold: int = 15
    _age: int = 0

    def target(self, thing: Thing, car: Thing) -> Array:
        """Velocity that the person wants (2,) [m/s]."""
        return np.array(self.velocities[(self._age // self.hold) % len(self.velocities)])

    def advance(self, thing: Thing, car: Thing, dt: float) -> tuple[float, float, float]:
        """One period at constant acceleration."""
        target = self.target(thing, car)
        self._age += 1
        target = target * min(1.0, WALK_SPEED / max(math.hypot(*target), 1e-9))
        change = target - thing.velocity
        change = change * min(1.0, WALK_ACCELERATION * dt / max(math.hypot(*change), 1e-9))
        mean = thing.velocity + 0.5 * change
        thing.velocity = thing.velocity + change
        return thing.x + mean[0] * dt, thing.y + mean[1] * dt, 0.0


@dataclass
class Chase(Walk):
    """A person who walks at the front of the car."""

    velocities: list[tuple[float, float]] = field(default_factory=list)

    def target(self, thing: Thing, car: Thing) -> Array:
        """Straight at the car."""
        nose = np.array([car.x + 2.0 * math.cos(car.yaw), car.y + 2.0 * math.sin(car.yaw)])
        way = nose - (thing.x, thing.y)
        return np.asarray(WALK_SPEED * way / max(math.hypot(*way), 1e-9))


@dataclass
class Roll:
    """A vehicle along the road at an offset; it brakes to rest from `brake_at` [periods] on.

    `speed` [m/s] is negative for oncoming ones. It does not run into a car ahead in its lane.
    """

    road: Road
    speed: float
    offset: float
    brake_at: int = 10_000
    deceleration: float = 7.0
    _age: int = 0

    def advance(self, thing: Thing, car: Thing, dt: float) -> tuple[float, float, float]:
        """One period at constant deceleration."""
        ((s, ahead), (_, aside)) = self.road.locate(np.array([[thing.x, thing.y], [car.x, car.y]]))
        gap = math.copysign(1.0, self.speed) * (ahead - s) - 4.5
        stopping = self.speed**2 / (2.0 * self.deceleration) + 0.5 * abs(self.speed) + 1.0
        blocked = abs(aside - self.offset) < 3.0 and -2.0 < gap < stopping
        self._age += 1
        before = self.speed
        if blocked or self._age > self.brake_at:
            left = max(abs(before) - self.deceleration * dt, 0.0)
            self.speed = math.copysign(left, before)
        mean = 0.5 * (before + self.speed)
        x, y, yaw = self.road.place(
            s + mean * dt / max(1.0 - self.road.curvature * self.offset, 0.2), self.offset
        )
        thing.velocity = self.speed * np.array([math.cos(yaw), math.sin(yaw)])
        return x, y, yaw
