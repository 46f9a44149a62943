"""Whether a motion ends at rest, within the corridor, and clear of all that may be there meanwhile.

An obstacle is a set of hits. Where a hit may be at time t is a disc: it stands, or goes on as it
was last seen, and its radius grows with the error of its velocity and with what it can accelerate.
The body is a rectangle; distances are measured from the hits in its frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shield.errors import Array, Mask
from shield.predictive.assumptions import Assumptions
from shield.predictive.backups import Motions
from shield.vehicle import VehicleGeometry
from shield.world.world import INTRUSION_SPEED, Kind, Obstacles, World

__all__ = ["Certification", "Threats", "Verdicts"]

NAMES = {Kind.STRUCTURE: "a wall", Kind.VEHICLE: "vehicle", Kind.PERSON: "person or post"}
WALKING = 0.3  # [m/s] a slower person counts as standing
ROLLING = 0.5  # [m/s] a slower vehicle counts as standing
VEHICLE_GROWTH = 0.5  # [m/s] added to the velocity's error of a moving vehicle
LEAST_MARGIN = 0.1  # [m] that a car which is nearer than its margin keeps in any case
BESIDE_ROOM = 0.5  # [m] beyond the corridor's edges where things that stand may still be near
ARC_STEP, ARC_MARGIN = 0.25, 0.15  # [m] along and beside the arcs of a detour
# [m] by which corners may swing out on a detour that leads back, and how far along it; share of the
# lane's error up to which they may
SWING, SWING_LENGTH, SWING_SHARE = 0.05, 1.5, 0.5
RETURN = 0.05  # by how much less a car outside has to be so, per metre
REST = 0.05  # [m/s] at which a car stands
# Ahead of the bumper, in lengths of the car, that a car which stops needs to steer free; and beside
# the body [m]
STANDING_ROOM, STANDING_MARGIN = 0.55, 0.2


@dataclass(frozen=True, slots=True)
class Threats:
    """Discs that move and grow: at time t around p + u t + w t²/2.

    The radius is min(error t + acceleration t²/2, fastest t), t from when each was last seen.

    Attributes:
        points: p (n, 2) [m].
        velocity: u (n, 2) [m/s].
        bend: w (n, 2) [m/s²], of what follows a bend.
        error, acceleration, fastest: Of the growth (n,) [m/s], [m/s²], [m/s].
        age: Time since it was seen (n,) [s].
        source: Row of the obstacle's hit (n,), -1 for unknown space.
    """

    points: Array
    velocity: Array
    bend: Array
    error: Array
    acceleration: Array
    fastest: Array
    age: Array
    source: NDArray[np.int64]

    @classmethod
    def of(cls, world: World, assumptions: Assumptions, horizon: float) -> "Threats":
        """All that a car could meet within `horizon` [m] of its rear axle."""
        known = world.obstacles
        near = np.hypot(*known.points.T) < horizon
        if world.corridor is not None:
            # The body stays within the corridor: what stands beyond its edges is out of reach.
            _, aside = world.corridor.locate(known.points)
            room = np.where(known.kind == Kind.PERSON, horizon, BESIDE_ROOM)
            near &= (aside > world.corridor.right - room) & (aside < world.corridor.left + room)
        (near,) = np.nonzero(near)
        rows = [cls._unknown(world, horizon)]
        if assumptions.level == "P1":
            fast = np.full(len(near), assumptions.object_speed)
            rows.append(cls._at(known, near, 0.0, fast, 0.0, assumptions.object_speed))
        else:
            person = known.kind[near] == Kind.PERSON
            rows += cls._people(known, near[person], assumptions)
            rows += cls._others(world, near[~person])
        names = cls.__slots__
        return cls(*(np.concatenate([getattr(row, name) for row in rows]) for name in names))

    @classmethod
    def _at(
        cls,
        known: Obstacles,
        rows: NDArray[np.int64],
        share: float,
        error: Array,
        acceleration: float,
        fastest: float,
    ) -> "Threats":
        count = len(rows)
        return cls(
            known.points[rows],
            share * known.velocity[rows],
            np.zeros((count, 2)),
            error,
            np.full(count, acceleration),
            np.full(count, fastest),
            known.age[rows],
            rows,
        )

    @classmethod
    def _people(
        cls, known: Obstacles, rows: NDArray[np.int64], assumptions: Assumptions
    ) -> list["Threats"]:
        """People set off, go on, or stop."""
        push, fast = assumptions.person_acceleration, assumptions.person_speed
        walks = np.hypot(*known.velocity[rows].T) > WALKING
        stands, walks = rows[~walks], rows[walks]
        error = known.error
        return [
            cls._at(known, stands, 0.0, error[stands], push, fast),
            cls._at(known, walks, 0.0, 0.0 * error[walks], 0.0, fast),
            cls._at(known, walks, 0.5, 0.5 * error[walks], 0.5 * push, fast),
            cls._at(known, walks, 1.0, error[walks], push, 2.0 * fast),
        ]

    @classmethod
    def _others(cls, world: World, rows: NDArray[np.int64]) -> list["Threats"]:
        """Everything else stands; vehicles in our lanes may also go on along the road."""
        known, road = world.obstacles, world.corridor
        threats = [cls._at(known, rows, 0.0, np.zeros(len(rows)), 0.0, 0.0)]
        pace = np.hypot(*known.velocity[rows].T)
        rolls = (known.kind[rows] == Kind.VEHICLE) & (pace > ROLLING)
        rolls &= known.velocity[rows, 0] > 0.0
        along, aside = np.zeros((2, len(rows)))
        if road is not None:
            along, aside = road.locate(known.points[rows])
            rolls &= (aside > road.right) & (aside < road.left)
        if not rolls.any():
            return threats
        rows, pace, along = rows[rolls], pace[rolls], along[rolls]
        ways = known.velocity[rows] / pace[:, None]
        turn = np.zeros(len(rows)) if road is None else road.curvature_at(along)
        normal = np.stack([-ways[:, 1], ways[:, 0]], axis=1)
        error, zero = known.error[rows] + VEHICLE_GROWTH, np.zeros(len(rows))
        for v in (0.5 * pace, np.maximum(pace - error, 0.0), pace + error):
            bend = (turn * v * v)[:, None] * normal
            threats.append(
                cls(known.points[rows], v[:, None] * ways, bend, zero, zero, zero, zero, rows)
            )
        return threats

    @classmethod
    def _unknown(cls, world: World, horizon: float) -> "Threats":
        """Unknown space, from where anything may come."""
        edge = world.frontier[np.hypot(*world.frontier.T) < horizon]
        count = len(edge)
        speed, zero, flat = np.full(count, INTRUSION_SPEED), np.zeros(count), np.zeros((count, 2))
        return cls(edge, flat, flat, speed, zero, speed, zero, np.full(count, -1))

    def centres(self, time: Array) -> tuple[Array, Array]:
        """Coordinates of the centres at times (m,) [s]: twice (m, n) [m]."""
        t = time[:, None]
        half = 0.5 * t * t
        x, y = self.points.T
        u, v = self.velocity.T
        return x + u * t + self.bend[:, 0] * half, y + v * t + self.bend[:, 1] * half

    def radius(self, time: Array) -> Array:
        """Radii (m, n) at times (m,) [s]."""
        t = time[:, None] + self.age
        grown = self.error * t + 0.5 * self.acceleration * t * t
        return np.minimum(grown, self.fastest * t)


@dataclass(frozen=True, slots=True)
class Verdicts:
    """What the checks say of B motions.

    Attributes:
        certified: Whether all checks hold (B,).
        missing: By how much the worst obstacle check fails (B,) [m], negative where it holds.
        needed: The distance that it asks for (B,) [m].
        threat: The worst threat (B,), -1 without any.
        period: When it is worst (B,).
        outside: By how much the corridor is left (B,) [m], negative where it is kept.
        cramped: Whether the car would stop with no room to steer free (B,).
    """

    certified: Mask
    missing: Array
    needed: Array
    threat: Array
    period: Array
    outside: Array
    cramped: Mask


class Certification:
    """The checks of one step."""

    def __init__(
        self,
        world: World,
        assumptions: Assumptions,
        vehicle: VehicleGeometry,
        dt: float,
        braking: float,
        scanner_clearance: float,
    ) -> None:
        self._scanner_clearance = scanner_clearance
        self._world, self._assumptions, self._vehicle, self._dt = world, assumptions, vehicle, dt
        speed = abs(world.speed)
        self._stop_time = speed / braking + 3.0 * dt
        self._room = STANDING_ROOM * vehicle.length
        horizon = speed * self._stop_time + vehicle.front_bumper + self._room + 3.0
        self.threats = Threats.of(world, assumptions, horizon)
        self._margin = assumptions.range_error + assumptions.tracking_error
        now = np.zeros((1, 1))
        radius = self.threats.radius(np.zeros(1))
        self._clear_now = self._clearance(now, now, now, radius)
        self._clear_now = self._clear_now[0, 0]
        corridor = world.corridor
        self._outside_now = 0.0
        if corridor is not None:
            offset, heading, curvature, _ = corridor.lane
            pose = np.full((1, 1), offset), np.full((1, 1), heading), np.full((1, 1), curvature)
            self._outside_now = float(self._outside(*pose)[0, 0])

    def check(self, motions: Motions, margin: float, *, roomy: bool = True) -> Verdicts:
        """Check motions (B, N) with a margin beyond that of the assumptions [m].

        `roomy` asks for room to steer free where the car stops. Without it the car is on a detour:
        from outside the corridor a corner may swing out on the way in.
        """
        speed = motions.commands[..., 1]
        last = max(1, int((np.abs(speed) > REST).any(axis=0).sum()) + 1)
        x, y, yaw = motions.x[:, :last], motions.y[:, :last], motions.yaw[:, :last]
        count = len(x)
        missing, needed = np.full(count, -np.inf), np.zeros(count)
        threat, period = np.full(count, -1), np.zeros(count, int)
        cramped = np.zeros(count, np.bool_)
        if len(self.threats.points):
            steps = np.arange(1, last + 1, dtype=np.float64)
            time = self._assumptions.delay + self._dt * steps
            radius = self.threats.radius(time)
            gap = self._clearance(x, y, yaw, radius, time)
            # What is nearer already must not come nearer than to a car that stands.
            standing = np.maximum(self._clear_now - radius, LEAST_MARGIN)
            asked = np.minimum(self._margin + margin, standing)
            short = (asked - gap).reshape(count, -1)
            worst = short.argmax(axis=1)
            missing = short[np.arange(count), worst]
            period, threat = np.divmod(worst, gap.shape[2])
            needed = asked.ravel()[worst]
            if roomy:
                cramped = self._cramped(x[:, -1], y[:, -1], yaw[:, -1])
        outside = np.full(count, -np.inf)
        if self._world.lanes is not None:
            if self._world.corridor is None:
                outside = np.full(count, np.inf)
            else:
                pose = motions.offset, motions.heading_error, motions.curvature
                left = self._outside(*(values[:, :last] for values in pose))
                outside = left.max(axis=1) + 0.5 * margin
                if self._outside_now + 0.5 * margin > 0.0:
                    # From outside, what leads back is the way in.
                    now = self._outside_now
                    back = (left.max(axis=1) <= now) & (left[:, -1] < now)
                    if not roomy:  # a tolerance on what is now alone would be a ratchet
                        swung = min(now + SWING, SWING_SHARE * self._lane_error())
                        back |= left.max(axis=1) <= swung
                    outside = np.where(back, 0.0, np.maximum(outside, 1e-3))
        certified = (missing <= 0.0) & (outside <= 0.0) & ~cramped
        return Verdicts(certified, missing, needed, threat, period, outside, cramped)

    def refusal(self, verdicts: Verdicts, row: int) -> str:
        """Which check a motion fails, by how much and when, for people."""
        if verdicts.outside[row] > 0.0:
            if self._world.corridor is None:
                return "needs a lane, and the lane is lost"
            return f"would leave the lanes by {verdicts.outside[row]:.2f} m"
        if verdicts.missing[row] > 0.0:
            when = self._dt * (int(verdicts.period[row]) + 1)
            gap, needed = verdicts.needed[row] - verdicts.missing[row], verdicts.needed[row]
            what = self._name_of(int(verdicts.threat[row]))
            return f"would pass {what} at {gap:.2f} m of {needed:.2f} m in {when:.1f} s"
        return "would stop too near to steer free"

    def _name_of(self, threat: int) -> str:
        """What a threat is, for people."""
        source = int(self.threats.source[threat])
        if source < 0:
            return "unknown space"
        known = self._world.obstacles
        kind = NAMES[Kind(int(known.kind[source]))]
        number = int(known.number[source])
        return kind if number < 0 else f"{kind} {number}"

    def free_arcs(self, steering: Array, wheelbase: float, reach: float) -> Array:
        """How far a creeping car could go on with each steering angle (B,), up to `reach` [m]."""
        along = np.arange(ARC_STEP, reach + 0.5 * ARC_STEP, ARC_STEP)
        turn = np.tan(steering)[:, None] / wheelbase
        yaw = turn * along
        bend = np.where(np.abs(turn) < 1e-6, 1e-6, turn)
        x, y = np.sin(bend * along) / bend, (1.0 - np.cos(bend * along)) / bend
        free = np.ones(x.shape, np.bool_)
        if len(self.threats.points):
            radius = np.zeros((1, len(self.threats.points)))
            gap = self._clearance(x, y, yaw, radius)
            needed = np.minimum(self._margin + ARC_MARGIN, self._clear_now)
            free &= (gap >= needed).all(axis=2)
        road = self._world.corridor
        if road is not None:
            place = np.stack([x.ravel(), y.ravel()], axis=1)
            s, offset = (values.reshape(x.shape) for values in road.locate(place))
            ways = road.direction(s.ravel())
            heading = yaw - np.arctan2(ways[:, 1], ways[:, 0]).reshape(x.shape)
            outside = self._outside(offset, heading, np.full(x.shape, road.lane[2]))
            swung = np.where(along < SWING_LENGTH, SWING, 0.0)
            free &= outside <= np.maximum(self._outside_now - along * RETURN, 0.0) + swung
        return np.asarray(ARC_STEP * np.logical_and.accumulate(free, axis=1).sum(axis=1))

    def _clearance(
        self, x: Array, y: Array, yaw: Array, radius: Array, time: Array | None = None
    ) -> Array:
        """Distance (B, N, n) from the body to the discs [m], negative inside."""
        threats, vehicle = self.threats, self._vehicle
        px, py = threats.points.T if time is None else threats.centres(time)
        cos, sin = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
        dx, dy = px - x[..., None], py - y[..., None]
        middle = vehicle.front_bumper - 0.5 * vehicle.length
        ahead = np.abs(cos * dx + sin * dy - middle) - 0.5 * vehicle.length
        aside = np.abs(cos * dy - sin * dx) - 0.5 * vehicle.width
        apart = np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0))
        apart = apart + np.minimum(np.maximum(ahead, aside), 0.0) - radius
        if self._scanner_clearance:
            front = self._world.scanner.mount
            from_scanner = np.hypot(cos * dx + sin * dy - front, cos * dy - sin * dx)
            apart = np.minimum(apart, from_scanner - self._scanner_clearance + self._margin)
        return np.asarray(apart)

    def _cramped(self, x: Array, y: Array, yaw: Array) -> Mask:
        """Whether something stands right before the bumper of cars at rest (B,)."""
        px, py = self.threats.points.T
        cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        dx, dy = px - x[:, None], py - y[:, None]
        ahead = cos * dx + sin * dy - self._vehicle.front_bumper
        aside = np.abs(cos * dy - sin * dx) - 0.5 * self._vehicle.width
        return np.asarray(
            ((ahead > 0.0) & (ahead < self._room) & (aside < STANDING_MARGIN)).any(axis=1)
        )

    def _lane_error(self) -> float:
        """By how much the lane estimate may err at the bumper [m] (A9)."""
        corridor, assumed = self._world.corridor, self._assumptions
        assert corridor is not None
        seen = 0.5 * assumed.lane_preview**2 * abs(corridor.lane[3])
        return assumed.lane_sigmas * corridor.std + seen

    def _outside(self, offset: Array, heading: Array, curvature: Array) -> Array:
        """By how much the corners leave the corridor, or the nose turns out of it (B, N) [m]."""
        corridor, vehicle = self._world.corridor, self._vehicle
        assert corridor is not None
        assumed, error = self._assumptions, self._lane_error()
        sin, half = np.sin(heading), 0.5 * vehicle.width * np.cos(heading)
        front, rear = vehicle.front_bumper, vehicle.rear_overhang
        nose = offset + front * sin - 0.5 * curvature * front * front
        tail = offset - rear * sin - 0.5 * curvature * rear * rear
        left = np.maximum(nose, tail) + half - corridor.left
        right = corridor.right - np.minimum(nose, tail) + half
        turned = (np.abs(heading) - assumed.lane_heading) * front
        return np.asarray(np.maximum(np.maximum(left, right) + error, turned))
