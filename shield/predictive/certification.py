"""Whether a motion ends at rest, within the corridor, and clear of all that may be there meanwhile.

An obstacle is a set of hits. Where a hit may be at time t is a disc: it stands, or goes on as it
was last seen, and its radius grows with the error of its velocity and with what it can accelerate.
The body is a rectangle; distances are measured from the hits in its frame.
"""

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from shield.errors import Array, Mask
from shield.predictive.assumptions import Assumptions
from shield.predictive.backups import REST, Motions
from shield.predictive.threats import WALKING, Threats
from shield.vehicle import VehicleGeometry
from shield.world.world import Index, Kind, World

__all__ = ["Certification"]

NAMES = dict(zip(Kind, ("a wall", "vehicle", "person or post", "what was last seen"), strict=True))
FRESH_MARGIN = 0.1  # [m] that a new commitment keeps beyond what the assumptions ask for
LEAST_MARGIN = 0.1  # [m] that a car which is nearer than its margin keeps in any case
ARC_STEP, ARC_MARGIN = 0.25, 0.15  # [m] along and beside the arcs of a detour
RETURN = 0.05  # by how much less a car outside has to be so, per metre
ROUNDING = 1e-9  # [m] that quick bounds on a distance concede
PART = 512  # pairs of a period and a threat that are checked before motions which fail are dropped
# Ahead of the bumper, in lengths of the car, that a car which stops needs to steer free; and beside
# the body [m]
STANDING_ROOM, STANDING_MARGIN = 0.55, 0.2
CROSSING = np.arange(0.0, 2.1, 0.5)  # [s] after the stop for which no walker may be in it


class _Pairs(NamedTuple):
    """When and what motions could come too near (m,), where it may be then, and what it needs."""

    periods: Index
    threats: Index
    x: Array
    y: Array
    radius: Array
    needed: Array


class Certification:
    """The checks of one step.

    Attributes:
        threats: What a motion has to keep clear of.
        outside_now: By how much the corridor may be left at present [m], negative inside of it.
    """

    def __init__(
        self,
        world: World,
        assumptions: Assumptions,
        vehicle: VehicleGeometry,
        dt: float,
        braking: float,
        scanner_clearance: float,
        lead: int = 1,
    ) -> None:
        self._scanner_clearance = scanner_clearance
        self._world, self._assumptions, self._vehicle, self._dt = world, assumptions, vehicle, dt
        speed = abs(world.speed)
        self._room = STANDING_ROOM * vehicle.length
        horizon = (
            speed * (speed / braking + (2.0 + lead) * dt) + vehicle.front_bumper + self._room + 3.0
        )
        self.threats = Threats.of(world, assumptions, horizon)
        self._lead = (lead - 1) * dt
        self._margin = assumptions.range_error + assumptions.tracking_error
        corridor = world.corridor
        self.outside_now = self._turned_now = 0.0
        if corridor is not None:
            offset, heading, curvature, _ = corridor.lane
            pose = np.full((1, 1), offset), np.full((1, 1), heading), np.full((1, 1), curvature)
            self.outside_now = float(self._outside(*pose)[0, 0])
            self._turned_now = float(self._turned(pose[1])[0, 0])

    def check(self, motions: Motions, *, roomy: bool = True) -> Mask:
        """Which motions (B, N) may be committed to, shape (B,).

        `roomy` asks for room to steer free where the car stops.
        """
        last = motions.periods_to_rest
        certified = self._departure(motions, last) <= 0.0
        (rows,) = np.nonzero(certified)
        x, y, yaw = (values[rows, :last] for values in (motions.x, motions.y, motions.yaw))
        clear = self._keep_clear(x, y, yaw)
        if roomy:
            clear &= ~self._cramped(x[:, -1], y[:, -1], yaw[:, -1], self._dt * last)
        certified[rows] = clear
        if abs(self._world.speed) < REST:  # a car that stands, and goes on standing, may steer
            certified |= (motions.commands[..., 1] == 0.0).all(axis=1)
        return certified

    def refusal(self, motions: Motions) -> str:
        """Which check a motion (1, N) fails, by how much and when, for people."""
        last = motions.periods_to_rest
        outside = float(self._departure(motions, last)[0])
        if not outside <= 0.0:
            if self._world.corridor is None:
                return "needs a lane, and the lane is lost"
            return f"would leave the lanes by {outside:.2f} m"
        x, y, yaw = (values[:, :last] for values in (motions.x, motions.y, motions.yaw))
        pairs = self._pairs(x, y, yaw)
        (missing,) = self._missing(x, y, yaw, pairs)
        if (missing > 0.0).any():
            worst = missing.argmax()
            when, needed = self._dt * (pairs.periods[worst] + 1), pairs.needed[worst]
            gap, what = needed - missing[worst], self._name_of(int(pairs.threats[worst]))
            return f"would pass {what} at {gap:.2f} m of {needed:.2f} m in {when:.1f} s"
        return "would stop too near to steer free"

    def _departure(self, motions: Motions, last: int) -> Array:
        """By how much motions leave the corridor up to a period (B,) [m], not above 0: not."""
        if self._world.corridor is None:
            return np.full(len(motions.x), -np.inf if self._world.lanes is None else np.inf)
        heading = motions.heading_error[:, :last]
        pose = motions.offset[:, :last], heading, motions.curvature[:, :last]
        outside, turned = self._outside(*pose), self._turned(heading)
        left = _excess(outside, self.outside_now)
        away = _excess(turned, self._turned_now)
        return np.maximum(left, away)

    def _keep_clear(self, x: Array, y: Array, yaw: Array) -> Mask:
        """Whether motions (b, N) keep their distance from all threats (b,)."""
        clear = np.ones(len(x), np.bool_)
        pairs = self._pairs(x, y, yaw)
        parts = math.ceil(len(pairs.x) / PART)
        for first in range(parts):
            # What has failed already need not be checked any further.
            (rows,) = np.nonzero(clear)
            part = _Pairs._make(values[first::parts] for values in pairs)
            missing = self._missing(x[rows], y[rows], yaw[rows], part)
            clear[rows] = (missing <= 0.0).all(axis=1)
        return clear

    def _pairs(self, x: Array, y: Array, yaw: Array) -> _Pairs:
        """What motions (b, N) could come too near; of everything else they are certainly clear."""
        time = self._assumptions.delay + self._dt * np.arange(1.0, x.shape[1] + 1.0)
        # By the end of the commands that lead, things will have been seen to move as they do.
        since = np.maximum(time - self._lead, time[0])
        radius, (px, py) = self.threats.radius(since), self.threats.centres(time)
        most = self._margin + FRESH_MARGIN
        chosen = self._near(x, y, yaw, px, py, radius + most)
        radius = radius[chosen]
        # What is nearer already must not come nearer than to a car that stands.
        standing = np.maximum(self._clear_now[chosen[1]] - radius, LEAST_MARGIN)
        return _Pairs(*chosen, px[chosen], py[chosen], radius, np.minimum(most, standing))

    def _missing(self, x: Array, y: Array, yaw: Array, pairs: _Pairs) -> Array:
        """By how much motions (b, N) are too near in each pair (b, m) [m], negative if not."""
        x, y, yaw = (values[:, pairs.periods] for values in (x, y, yaw))
        return pairs.needed - self._clearance(x, y, yaw, pairs.x, pairs.y, pairs.radius)

    @cached_property
    def _walking(self) -> Mask:
        """Which threats are people who walk (n,)."""
        threats, kinds = self.threats, self._world.obstacles.kind
        person = np.zeros(len(threats.source), np.bool_)
        known = threats.source >= 0
        person[known] = kinds[threats.source[known]] == Kind.PERSON
        return np.asarray(person & (np.hypot(*threats.velocity.T) > WALKING))

    @cached_property
    def _clear_now(self) -> Array:
        """Distance from the body to the threats as they are now (n,) [m]."""
        now, (px, py) = np.zeros(1), self.threats.points.T
        return self._clearance(now, now, now, px, py, self.threats.radius(now)[0])

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
        px, py = self.threats.points.T
        room = np.full((1, len(px)), self._margin + ARC_MARGIN)
        places, threats = self._near(x, y, yaw, px[None], py[None], room)
        for first in range(0, len(places), PART):
            # What is further along than something that blocks an arc need not be checked.
            (rows,) = np.nonzero(free.all(axis=1))
            at, what = places[first : first + PART], threats[first : first + PART]
            there = x[rows][:, at], y[rows][:, at], yaw[rows][:, at]
            gap = self._clearance(*there, px[what], py[what], np.zeros(len(what)))
            arc, pair = np.nonzero(~(gap >= np.minimum(room[0, what], self._clear_now[what])))
            free[rows[arc], at[pair]] = False
        road = self._world.corridor
        if road is not None:
            place = np.stack([x.ravel(), y.ravel()], axis=1)
            s, offset = (values.reshape(x.shape) for values in road.locate(place))
            ways = road.direction(s.ravel())
            heading = yaw - np.arctan2(ways[:, 1], ways[:, 0]).reshape(x.shape)
            bend = np.full(x.shape, road.lane[2])
            back = np.maximum(self.outside_now - along * RETURN, -0.5 * FRESH_MARGIN)
            free &= self._outside(offset, heading, bend) <= back
            free &= self._turned(heading) <= max(self._turned_now, 0.0)
        return np.asarray(ARC_STEP * np.logical_and.accumulate(free, axis=1).sum(axis=1))

    def _near(
        self, x: Array, y: Array, yaw: Array, px: Array, py: Array, room: Array
    ) -> tuple[Index, Index]:
        """Period and number (m,) of the centres (N, n) that a body (b, N) may have within `room`.

        All others are further from the box around the bodies of a period, along x or along y.
        """
        vehicle, mount = self._vehicle, self._world.scanner.mount
        front, rear = max(vehicle.front_bumper, mount), max(vehicle.rear_overhang, -mount)
        if not x.size or not px.size:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        cos, sin = np.cos(yaw), np.sin(yaw)
        room = room + max(self._scanner_clearance - self._margin, 0.0) + ROUNDING
        far: Mask = np.zeros((x.shape[1], 1), np.bool_)
        for place, centre, along, across in ((px, x, cos, sin), (py, y, sin, cos)):
            extent = 0.5 * (front + rear) * np.abs(along) + 0.5 * vehicle.width * np.abs(across)
            middle = centre + 0.5 * (front - rear) * along
            low, high = (middle - extent).min(axis=0), (middle + extent).max(axis=0)
            far = far | (low[:, None] - place > room) | (place - high[:, None] > room)
        periods, numbers = np.nonzero(~far)
        return periods, numbers

    def _clearance(
        self, x: Array, y: Array, yaw: Array, px: Array, py: Array, radius: Array
    ) -> Array:
        """Distance (b, m) from bodies to discs at (m,) [m], negative inside."""
        vehicle = self._vehicle
        cos, sin = np.cos(yaw), np.sin(yaw)
        dx, dy = px - x, py - y
        ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
        middle = vehicle.front_bumper - 0.5 * vehicle.length
        beyond = np.abs(ahead - middle) - 0.5 * vehicle.length
        aside = np.abs(left) - 0.5 * vehicle.width
        apart = np.hypot(np.maximum(beyond, 0.0), np.maximum(aside, 0.0))
        apart = apart + np.minimum(np.maximum(beyond, aside), 0.0) - radius
        if self._scanner_clearance:
            from_scanner = np.hypot(ahead - self._world.scanner.mount, left)
            apart = np.minimum(apart, from_scanner - self._scanner_clearance + self._margin)
        return np.asarray(apart)

    def _cramped(self, x: Array, y: Array, yaw: Array, when: float) -> Mask:
        """Whether something stands right before the bumper of cars at rest from `when` on (B,).

        Or will walk there: a person who crosses keeps the distance that the car has left.
        """
        walking = self._walking
        px, py = np.concatenate(
            [
                self.threats.points.T,
                np.stack(self.threats.centres(when + CROSSING))[:, :, walking].reshape(2, -1),
            ],
            axis=1,
        )
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
        return assumed.lane_sigmas * corridor.std + assumed.lane_error

    def _turned(self, heading: Array) -> Array:
        """By how much the nose turns out of the directions in which the lane is in view [m]."""
        beyond = np.abs(heading) - self._assumptions.lane_heading
        return np.asarray(beyond * self._vehicle.front_bumper)

    def _outside(self, offset: Array, heading: Array, curvature: Array) -> Array:
        """By how much the corners leave the corridor (B, N) [m]."""
        corridor, vehicle, error = self._world.corridor, self._vehicle, self._lane_error()
        assert corridor is not None
        sin, half = np.sin(heading), 0.5 * vehicle.width * np.cos(heading)
        front, rear = vehicle.front_bumper, vehicle.rear_overhang
        nose = offset + front * sin - 0.5 * curvature * front * front
        tail = offset - rear * sin - 0.5 * curvature * rear * rear
        left = np.maximum(nose, tail) + half - corridor.left
        right = corridor.right - np.minimum(nose, tail) + half
        return np.asarray(np.maximum(left, right) + error)


def _excess(left: Array, now: float) -> Array:
    """Worst of excesses (B, N) with a margin, (B,) [m]; none for the way back from outside."""
    worst = left.max(axis=1) + 0.5 * FRESH_MARGIN
    if now + 0.5 * FRESH_MARGIN <= 0.0:
        return np.asarray(worst)
    # From outside, what ends further in, and no corner further out meanwhile, is the way back.
    back = (left.max(axis=1) <= now) & (left[:, -1] < now)
    return np.where(back, 0.0, np.maximum(worst, 1e-3))
