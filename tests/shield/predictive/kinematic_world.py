"""A small exact world: a bicycle with a rectangle for a body, things, a road and a scanner.

No physics: what the filter commands is what the car does, within its assumptions. Contacts and
departures are tested at `SUBSTEPS` instants of every period.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from shield import ActuatorLimits, LaneEstimate, PredictiveFilter, ScannerGeometry, VehicleGeometry
from tests.shield.predictive.bodies import Array, Road, Thing

SUBSTEPS = 4  # instants of a period at which contacts are tested
MOVING = 0.1  # [m/s] a slower car is at rest
LANE_STD, LANE_NOISE = 0.03, 0.06  # [m] stated, and the largest there is
RANGE_NOISE = 0.05  # [m] largest error of a range
THROUGH = 10  # periods for which a person who walked through something solid is not known
REMEMBERED = 40  # periods for which the shield remembers a person whom no beam hits (A8)

Driver = Callable[["KinematicWorld", int], Array]
Defect = Callable[[Array, int], Array]


@dataclass(frozen=True)
class Event:
    """A contact with a thing, or a departure from the lanes (`thing` -1)."""

    step: int
    thing: int
    moving: bool
    by_other: bool
    seen: float  # periods since a beam last hit it
    apart: float = math.inf  # periods since its middle was in something solid

    @property
    def at_fault(self) -> bool:
        """Whether the moving car touched what it could know of, and not because of a push."""
        known = self.seen <= REMEMBERED and self.apart > THROUGH
        return self.thing < 0 or (self.moving and known and not self.by_other)


@dataclass
class Record:
    """What happened in a drive."""

    commands: list[Array] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    distance: float = 0.0

    @property
    def faults(self) -> list[Event]:
        """Contacts of the moving car, and departures."""
        return [event for event in self.events if event.at_fault]


def cast(
    scanner: ScannerGeometry, origin: tuple[float, float, float], things: list[Thing]
) -> Array:
    """Exact ranges (n,) [m] from a pose, infinite where nothing is hit, and which thing it is.

    Shape (2, n): ranges, and the index of the thing or -1.
    """
    x, y, yaw = origin
    angles = scanner.angles + yaw
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    nearest, what = np.full(len(rays), np.inf), np.full(len(rays), -1.0)
    for index, thing in enumerate(things):
        if thing.length is None:
            hits = _disc(rays, np.array([thing.x - x, thing.y - y]), 0.5 * thing.width)
        else:
            hits = _box(rays, thing.corners() - (x, y))
        what = np.where(hits < nearest, index, what)
        nearest = np.minimum(nearest, hits)
    nearest = np.where(nearest < scanner.max_range, nearest, np.inf)
    return np.stack([nearest, np.where(np.isfinite(nearest), what, -1.0)])


def _disc(rays: Array, centre: Array, radius: float) -> Array:
    along = rays @ centre
    inside = radius**2 - (centre @ centre - along**2)
    hit = (inside >= 0.0) & (along > 0.0)
    return np.where(hit, along - np.sqrt(np.maximum(inside, 0.0)), np.inf)


def _box(rays: Array, corners: Array) -> Array:
    nearest = np.full(len(rays), np.inf)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = end - start
        cross = rays[:, 0] * edge[1] - rays[:, 1] * edge[0]
        safe = np.where(np.abs(cross) < 1e-12, np.nan, cross)
        along = (start[0] * edge[1] - start[1] * edge[0]) / safe
        place = (start[0] * rays[:, 1] - start[1] * rays[:, 0]) / safe
        hit = (along > 0.0) & (place >= 0.0) & (place <= 1.0)
        nearest = np.where(hit, np.minimum(nearest, along), nearest)
    return nearest


@dataclass
class KinematicWorld:
    """A car among things.

    `pose` is that of the rear axle [m], [m], [rad]; noise comes from `rng`, if there is one.
    """

    things: list[Thing]
    road: Road | None = field(default_factory=Road)
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed: float = 0.0
    steering: float = 0.0
    limits: ActuatorLimits = field(default_factory=ActuatorLimits)
    geometry: VehicleGeometry = field(default_factory=VehicleGeometry)
    scanner: ScannerGeometry = field(default_factory=ScannerGeometry)
    understeer: float = 0.002
    rng: np.random.Generator | None = None
    yaw_rate: float = 0.0

    def __post_init__(self) -> None:
        """Nobody has looked yet."""
        self.seen: list[float] = [-math.inf] * len(self.things)
        self.apart: list[float] = [math.inf] * len(self.things)

    def body(self) -> Thing:
        """The car's outline."""
        x, y, yaw = self.pose
        middle = self.geometry.front_bumper - 0.5 * self.geometry.length
        place = x + middle * math.cos(yaw), y + middle * math.sin(yaw)
        return Thing(*place, self.geometry.width, self.geometry.length, yaw)

    def scan(self) -> Array:
        """Ranges (n,) of the scanner [m]."""
        x, y, yaw = self.pose
        mount = self.scanner.mount
        origin = x + mount * math.cos(yaw), y + mount * math.sin(yaw), yaw
        ranges, what = cast(self.scanner, origin, self.things)
        never = [math.inf if age < 0 else age + 1 for age in self.seen]
        self.seen = [0 if i in what else age for i, age in enumerate(never)]
        if self.rng is not None:
            ranges = ranges + self.rng.uniform(-RANGE_NOISE, RANGE_NOISE, ranges.shape)
        return np.where(np.isfinite(ranges), np.maximum(ranges, 0.01), self.scanner.max_range)

    def lane(self) -> LaneEstimate | None:
        """The lane estimate, with bounded errors."""
        if self.road is None:
            return None
        x, y, yaw = self.pose
        (s,), (offset,) = self.road.locate(np.array([[x, y]]))
        heading = yaw - self.road.curvature * s
        heading = math.atan2(math.sin(heading), math.cos(heading))
        error = 0.0 if self.rng is None else self.rng.uniform(-LANE_NOISE, LANE_NOISE)
        return LaneEstimate(
            offset + error, heading, self.road.curvature, 0.0, LANE_STD, age=0.0, valid=True
        )

    def outside(self) -> float:
        """By how much a corner is out of the lanes [m]; negative inside."""
        if self.road is None:
            return -math.inf
        half, centres = 0.5 * self.road.lanes.width, self.road.lanes.centres
        _, aside = self.road.locate(self.body().corners())
        return max(float(aside.max()) - centres[-1] - half, centres[0] - half - float(aside.min()))

    def advance(self, command: Array, step: int) -> list[Event]:
        """Drive one period; speed and steering go linearly to the command."""
        dt, car = self.limits.dt, self.body()
        poses = [thing.next_pose(car, dt) for thing in self.things]
        starts = [(thing.x, thing.y, thing.yaw) for thing in self.things]
        (steering, speed), before = command.tolist(), (self.steering, self.speed)
        events: dict[int, Event] = {}
        begin = self.pose[2]
        for part in range(1, SUBSTEPS + 1):
            share = part / SUBSTEPS
            middle = share - 0.5 / SUBSTEPS
            v = before[1] + middle * (speed - before[1])
            angle = before[0] + middle * (steering - before[0])
            turn = v * math.tan(angle) / (self.limits.wheelbase * (1.0 + self.understeer * v * v))
            h, (x, y, yaw) = dt / SUBSTEPS, self.pose
            bearing = yaw + 0.5 * h * turn
            self.pose = (
                x + h * v * math.cos(bearing), y + h * v * math.sin(bearing), yaw + h * turn
            )  # fmt: skip
            self.speed = before[1] + share * (speed - before[1])
            for event in self._events(step, starts, poses, share):
                events.setdefault(event.thing, event)
        self.steering, self.yaw_rate = steering, (self.pose[2] - begin) / dt
        for thing, (x, y, yaw) in zip(self.things, poses, strict=True):
            thing.x, thing.y, thing.yaw = x, y, yaw
        self.apart = [
            0 if self._within(thing) else age + 1
            for thing, age in zip(self.things, self.apart, strict=True)
        ]
        return list(events.values())

    def _within(self, thing: Thing) -> bool:
        """Whether the middle of a person is in something solid."""
        middle = Thing(thing.x, thing.y, 0.0)
        solid = [other for other in self.things if other.length is not None]
        return thing.length is None and any(other.touches(middle) for other in solid)

    def _events(
        self,
        step: int,
        starts: list[tuple[float, float, float]],
        ends: list[tuple[float, float, float]],
        share: float,
    ) -> list[Event]:
        car, moving, events = self.body(), abs(self.speed) > MOVING, []
        ahead = np.array([math.cos(car.yaw), math.sin(car.yaw)])
        for index, (thing, start, end) in enumerate(zip(self.things, starts, ends, strict=True)):
            pose = tuple(a + share * (b - a) for a, b in zip(start, end, strict=True))
            now = thing.moved(pose)  # type: ignore[arg-type]
            if math.hypot(now.x - car.x, now.y - car.y) > 9.0 + (now.length or now.width):
                continue
            if car.touches(now):
                behind = float(ahead @ (now.x - car.x, now.y - car.y)) < -0.5
                by_other = behind and float(ahead @ thing.velocity) > self.speed
                events.append(
                    Event(step, index, moving, by_other, self.seen[index], self.apart[index])
                )
        if self.outside() > 0.0:
            events.append(Event(step, -1, moving, False, 0))
        return events


def drive(
    world: KinematicWorld,
    shield: PredictiveFilter,
    driver: Driver,
    steps: int,
    defect: Defect | None = None,
) -> Record:
    """Drive a world in closed loop until its end, a contact or a departure.

    Raises:
        AssertionError: A command breaks G1, G2 or G3.
    """
    record = Record()
    shield.reset([world.steering, world.speed])
    for step in range(steps):
        scan = world.scan()
        if defect is not None:
            scan = defect(scan, step)
        shield.update(scan, world.speed, world.yaw_rate, world.lane())
        previous = shield.previous
        certificate = shield.filter(driver(world, step))
        command = certificate.safe_action
        assert not world.limits.violated(command, previous)
        record.commands.append(command)
        record.reasons.append(certificate.reason)
        record.distance += 0.5 * (world.speed + float(command[1])) * world.limits.dt
        record.events += world.advance(command, step)
        record.speeds.append(world.speed)
        if record.events:
            break
    return record


def constant(steering: float, speed: float) -> Driver:
    """A driver who always wants the same [rad], [m/s]."""
    return lambda world, step: np.array([steering, speed])
