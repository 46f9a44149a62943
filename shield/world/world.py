"""What is around the car, built once a step: obstacles, unknown space and the corridor.

Everything is in the frame of the car: the middle of the rear axle, x ahead, y to the left. Hits of
the newest scan are joined by remembered ones: in directions that the scan says nothing about,
behind something nearer, out of the field of view, and for a few scans where a beam passes through
(a dropout looks like free space). Remembered hits move as their obstacle was last seen to move.

A direction in which nothing works is unknown, not free: there unknown space begins at the distance
up to which the way was last seen free, and comes nearer with every period.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.errors import Array, Mask, as_array, check_numbers
from shield.estimation.clusters import ClusterTracker, Track
from shield.estimation.lane import LaneEstimate, LaneGeometry
from shield.estimation.scan import ScanFilter, ScannerGeometry
from shield.vehicle import VehicleGeometry, carried
from shield.world.corridor import Corridor
from shield.world.free_space import FreeSpace
from shield.world.reading import Reading
from shield.world.rear import FAIR, FIRM, Rear

__all__ = ["Kind", "Obstacles", "World"]

Index = NDArray[np.int64]

PERSON_WIDTH = 1.0  # [m] anything wider is a vehicle or a wall
PERSON_SPEED = 2.5  # [m/s] from which narrow things drive
ROLLING = 0.5  # [m/s] a slower vehicle counts as standing
RUN = 0.8  # [m] between neighbours of a run of hits
MOVER, MOVER_TIME = 0.5, 5.0  # [m] around what has moved, and [s] after that, it may move on
VEHICLE_LENGTH = 7.0  # [m] longer clusters are walls and hedges, which stand
PIECE = 1.0  # [m] from a new cluster to something wide that it is a piece of
REAR_SEEN = 0.3  # [m] ahead of the scanner up to which a rear is in view
FIRM_ERROR, FAIR_ERROR, NEW_ERROR = 0.2, 0.6, 2.0  # [m/s] deviation of a velocity
NEAR = 0.7  # [m] a hit this near to a remembered one, along the beam, renews it
MISSES = 3  # scans in a row that look through a remembered hit before it is dropped
HIDDEN_TIME = 3.0  # [s] for which a hit behind something nearer is remembered
# [s] after which a person out of the field of view may be anywhere, and that of a car that stands
# [m/s]; after which anything else may. They may as well stand where they were last seen.
STRAY_TIME, STANDING_STRAY_TIME, STANDING = 1.5, 4.0, 0.3
BESIDE_TIME = 20.0
MEMORY_WIDTH, MEMORY_BEHIND = 12.0, 3.0  # [m] where remembered hits matter
LOOKED_PAST = 2  # beams beside a thing that go past it, if it ends there: one may be a dropout
COVERED_BY = 2  # beams to each side, one of which has to work for a direction to be seen
MIN_RETURNS = 5  # hits in view that cannot vanish all at once
INTRUSION_SPEED = 5.0  # [m/s] of what may enter unknown space
LEAST_KNOWN = 0.5  # [m] nearer to the scanner unknown space does not come


class Kind(IntEnum):
    """What an obstacle is taken for."""

    STRUCTURE = 0
    VEHICLE = 1
    PERSON = 2  # or anything as narrow: a post, a barrel
    GONE = 3  # out of view for long: it stands where it was last seen, or has left


@dataclass(slots=True)
class Obstacles:
    """Hits (n,), each with what is known of its obstacle.

    Attributes:
        points: Position (n, 2) [m].
        velocity: Over the ground (n, 2) [m/s].
        error: Deviation of the velocity (n,) [m/s].
        kind: `Kind` (n,).
        number: Of the tracked obstacle (n,); -1 for none.
        age: Time since it was seen (n,) [s].
        misses: Scans in a row that looked through it (n,).
    """

    points: Array
    velocity: Array
    error: Array
    kind: Index
    number: Index
    age: Array
    misses: Index

    @classmethod
    def none(cls) -> "Obstacles":
        """No hits."""
        whole = np.zeros(0, np.int64)
        pairs, flat = np.zeros((0, 2)), np.zeros(0)
        return cls(pairs, pairs, flat, whole, whole, flat, whole)

    def where(self, chosen: Mask) -> "Obstacles":
        """Those of a mask (n,)."""
        return Obstacles(*(getattr(self, name)[chosen] for name in self.__slots__))

    def joined(self, other: "Obstacles") -> "Obstacles":
        """These and others."""
        return Obstacles(
            *(np.concatenate([getattr(self, n), getattr(other, n)]) for n in self.__slots__)
        )


class World:
    """Obstacles, unknown space and corridor of the newest scan and of those before it.

    Args:
        dt: Period of the scans [s].
        scanner: Where it is and where its beams point.
        vehicle: Outline of the car.
        lanes: The lanes that the car may use; None where there are none.

    Attributes:
        obstacles: All hits.
        frontier: Where unknown space begins (k, 2), in the directions that were not seen [m].
        corridor: The road, as far as it is known; None where there are no lanes.
        speed: Own speed [m/s].
        flags: What could not be trusted in the newest scan.
        clean: That scan without its defects; its hits are the rows of the tracks.
        tracks: Its clusters; none of a scan that repeats itself.
        reading: What it was, for monitors.
    """

    def __init__(
        self,
        dt: float,
        scanner: ScannerGeometry,
        vehicle: VehicleGeometry,
        lanes: LaneGeometry | None,
    ) -> None:
        self.scanner, self.vehicle, self.lanes = scanner, vehicle, lanes
        self._dt = dt
        self._reach = scanner.max_range - 0.5
        self._angles = scanner.angles
        self._rays = np.stack([np.cos(self._angles), np.sin(self._angles)], axis=1)
        self._tracker = ClusterTracker(dt, scanner.mount, width=VEHICLE_LENGTH)
        self._scan_filter = ScanFilter(scanner.max_range)
        self._free = FreeSpace(dt, scanner)
        self.reset()

    def reset(self) -> None:
        """Forget the episode; before the first scan nothing is known."""
        self._tracker.reset()
        self._scan_filter.reset()
        self._free.reset()
        self._movers: Array = np.zeros((0, 3))  # x, y [m] and age [s] of hits that had moved
        self.obstacles = Obstacles.none()
        self._rears: dict[int, Rear] = {}
        self._driven = 0.0
        self._known: Array = np.full(self.scanner.beams, LEAST_KNOWN)
        self.frontier: Array = self._place(self._known)
        self.corridor: Corridor | None = None
        self.speed = 0.0
        self.flags: tuple[str, ...] = ()
        self.reading: Reading | None = None
        self.tracks: list[Track] = []
        self.clean = self._scan_filter.examine(np.full(self.scanner.beams, np.nan))

    def update(
        self, scan: ArrayLike, speed: float, yaw_rate: float, lane: LaneEstimate | None = None
    ) -> None:
        """Take a scan and a lane estimate.

        Args:
            scan: Ranges of the scanner's beams [m], shape (n,), as in `ScanFilter.examine`.
            speed: Own speed since the last scan [m/s]; the last known one if not finite.
            yaw_rate: Own yaw rate since the last scan [rad/s]; 0 if not finite.
            lane: Where the car is in its lane; None where it is not known.

        Raises:
            InvalidProblem: An argument is not of numbers, or `scan` not of the scanner's shape.
        """
        ranges = as_array("scan", scan, (self.scanner.beams,))
        check_numbers(speed=speed, yaw_rate=yaw_rate)
        self.reading, self.tracks = Reading(ranges, float(speed), float(yaw_rate), lane), []
        self.speed = float(speed) if math.isfinite(speed) else self.speed
        yaw_rate = float(yaw_rate) if math.isfinite(yaw_rate) else 0.0
        if self.lanes is not None:
            self.corridor = Corridor.around(lane, self.lanes)
        self.clean = clean = self._scan_filter.examine(ranges, self.speed)
        remembered = self._carry(self.speed, yaw_rate)
        hits = self.scanner.returned(clean.ranges)
        unseen = np.full(ranges.shape, clean.frozen) | ~_nearby(clean.working)
        repeated = bool(hits.any() and clean.repeated[hits].all())
        blank = not hits.any() and (self._beam_of(remembered.points)[0] >= 0).sum() >= MIN_RETURNS
        doubtful = unseen | ~clean.working | repeated | blank | ~_nearby(~clean.repeated)
        measured = np.where(hits, clean.ranges, np.inf)
        self._free.move(self.speed, yaw_rate)
        new = Obstacles.none()
        if not repeated:
            points = clean.ranges[hits, None] * self._rays[hits]
            past = _looks_past(np.where(clean.working, measured, 0.0))[:, hits]
            new = self._take(points, past, remembered, self.speed, yaw_rate)
            self._mark_movers(new)
            self._free.add(np.where(clean.working, measured, 0.0))
        self.obstacles = new.joined(self._keep(remembered, measured, doubtful))
        self._align(self.obstacles)
        self._shrink(unseen)
        self.flags = tuple(
            name
            for name, holds in (
                ("scanner frozen", clean.frozen or repeated),
                ("scanner blind", np.count_nonzero(unseen) > 0.5 * len(unseen)),
                ("lane lost", self.lanes is not None and self.corridor is None),
            )
            if holds
        )

    def _place(self, ranges: Array) -> Array:
        """Points (n, 2) at distances (n,) along the beams."""
        points = ranges[:, None] * self._rays
        return np.asarray(points + np.array([self.scanner.mount, 0.0]))

    def _beam_of(self, points: Array) -> tuple[Index, Array]:
        """Nearest beam of points (n, 2), -1 out of view, and their distance from the scanner."""
        ahead, left = points[:, 0] - self.scanner.mount, points[:, 1]
        angle = np.arctan2(left, ahead)
        spacing = self._angles[1] - self._angles[0]
        beam = np.rint((angle - self._angles[0]) / spacing).astype(np.int64)
        inside = (beam >= 0) & (beam < len(self._angles))
        return np.where(inside, beam, -1), np.hypot(ahead, left)

    def _carry(self, speed: float, yaw_rate: float) -> Obstacles:
        """Move what is known by one period, own motion and that of the obstacles."""
        known, dt = self.obstacles, self._dt
        self._movers[:, :2] = carried(self._movers[:, :2], speed, yaw_rate, dt)
        self._movers[:, 2] += dt
        return Obstacles(
            carried(known.points + known.velocity * dt, speed, yaw_rate, dt),
            carried(known.velocity, 0.0, yaw_rate, dt),
            known.error,
            known.kind,
            known.number,
            known.age + dt,
            known.misses,
        )

    def _take(
        self, points: Array, past: Mask, before: Obstacles, speed: float, yaw_rate: float
    ) -> Obstacles:
        """The obstacles of a scan's hits (n, 2) in the scanner's frame.

        `past` (2, n) says beside which hits, to the right and to the left, the scan looks past.
        """
        count, road = len(points), self.corridor
        distance = speed * self._dt
        self._driven += distance if road is None else road.advance(distance)
        placed = points + np.array([self.scanner.mount, 0.0])
        along = placed[:, 0] if road is None else road.locate(placed)[0]
        velocity, error = np.zeros((count, 2)), np.zeros(count)
        kind, number = np.full(count, int(Kind.STRUCTURE)), np.full(count, -1)
        remembered = set(self.obstacles.number.tolist())
        self._rears = {n: rear for n, rear in self._rears.items() if n in remembered}
        wide = before.where((before.kind != Kind.PERSON) & (before.kind != Kind.GONE))
        self.tracks = self._tracker.update(points, speed, yaw_rate)
        for track in self.tracks:
            if past[0, track.first] and past[1, track.last] and track.number in self._rears:
                # Seen as a whole: if it was wide, it was so together with something else.
                self._rears[track.number].wide = False
        for track, piece in zip(self.tracks, self._pieces(wide).tolist(), strict=True):
            rows = slice(track.first, track.last + 1)
            number[rows] = track.number
            if not piece and _may_walk(track):
                kind[rows], error[rows] = Kind.PERSON, NEW_ERROR
                if track.sightings >= FAIR:
                    velocity[rows] = track.velocity
                    error[rows] = FIRM_ERROR if track.sightings >= FIRM else FAIR_ERROR
                continue
            rear, place = self._rears.setdefault(track.number, Rear()), float(along[rows].min())
            rear.wide |= track.width >= PERSON_WIDTH
            if place > self.scanner.mount + REAR_SEEN:
                rear.see(self._driven + place, self._dt)
            kind[rows], velocity[rows] = Kind.VEHICLE, (rear.pace, 0.0)
            error[rows] = FIRM_ERROR if len(rear.places) >= FIRM else FAIR_ERROR
        return Obstacles(
            placed, velocity, error, kind, number, np.zeros(count), np.zeros(count, np.int64)
        )

    def _pieces(self, wide: Obstacles) -> Mask:
        """Which clusters (n,) are pieces of something wide.

        The end of a flank that comes into view seems to walk: `_mark_movers` tells the two apart.
        """
        numbers = [track.number for track in self.tracks]
        alone = [n not in self._rears or not self._rears[n].wide for n in numbers]
        # Its own hits are no more evidence than it is.
        apart = np.array([track.position for track in self.tracks]).reshape(-1, 1, 2) - wide.points
        apart += np.array([self.scanner.mount, 0.0])
        near = np.einsum("nmk,nmk->nm", apart, apart) < PIECE * PIECE
        own = np.array(numbers, np.int64)[:, None] == wide.number
        return np.asarray((near & ~(own & np.array(alone, np.bool_)[:, None])).any(axis=1))

    def _mark_movers(self, new: Obstacles) -> None:
        """Take hits that stand in free space for people, unless their vehicle rolls.

        Near enough to tell, a vehicle has been seen to be wide.
        """
        wide = [number for number, rear in self._rears.items() if rear.wide]
        rolls = np.isin(new.number, wide) & (np.hypot(*new.velocity.T) > ROLLING)
        entered = new.points[self._free.entered(new.points) & ~rolls]
        # A run of them that is wider than a person is a vehicle whose speed is not known yet.
        moved = np.concatenate([*_narrow_runs(entered), np.zeros((0, 2))])
        before = self._movers[self._movers[:, 2] < MOVER_TIME]
        before = before[~_near(before[:, :2], moved, MOVER)]
        self._movers = np.concatenate([before, np.insert(moved, 2, 0.0, axis=1)])
        people = _near(new.points, self._movers[:, :2], MOVER) & ~rolls & (new.kind != Kind.PERSON)
        new.kind[people], new.velocity[people], new.error[people] = Kind.PERSON, 0.0, NEW_ERROR

    def _align(self, obstacles: Obstacles) -> None:
        """Let vehicles go along the road."""
        vehicle = obstacles.kind == Kind.VEHICLE
        if self.corridor is not None and vehicle.any():
            along, _ = self.corridor.locate(obstacles.points[vehicle])
            velocity = obstacles.velocity[vehicle]
            pace = np.copysign(np.hypot(*velocity.T), velocity[:, 0])
            obstacles.velocity[vehicle] = pace[:, None] * self.corridor.direction(along)

    def _keep(self, known: Obstacles, measured: Array, doubtful: Mask) -> Obstacles:
        """What is remembered beside a scan (n,) [m], infinite where nothing returned."""
        if not len(known.points):
            return known
        beam, distance = self._beam_of(known.points)
        last = len(measured) - 1
        around = measured[np.clip(np.stack([beam - 1, beam, beam + 1]), 0, last)]
        in_view = beam >= 0
        doubted = in_view & doubtful[beam]
        renewed = in_view & ~doubted & (np.abs(around - distance) < NEAR).any(axis=0)
        hidden = in_view & ~renewed & (around[1] < distance)
        missed = in_view & ~doubted & ~renewed & ~hidden
        misses = np.where(missed, known.misses + 1, np.where(in_view & ~doubted, 0, known.misses))
        stray = STRAY_TIME if abs(self.speed) > STANDING else STANDING_STRAY_TIME
        limit = np.where(known.kind == Kind.PERSON, stray, BESIDE_TIME)
        gone = ~in_view & (known.kind != Kind.GONE) & (known.age > limit)
        known.points[gone] -= known.age[gone, None] * known.velocity[gone]
        known.kind[gone], known.velocity[gone] = Kind.GONE, 0.0
        x, y = known.points.T
        kept = ~renewed & (misses < MISSES) & ~(hidden & (known.age > HIDDEN_TIME))
        kept &= (x > -MEMORY_BEHIND) & (np.abs(y) < MEMORY_WIDTH)
        body = (x > -self.vehicle.rear_overhang) & (x < self.vehicle.front_bumper)
        body &= np.abs(y) < 0.5 * self.vehicle.width
        kept &= ~(body & (known.kind == Kind.GONE))  # the car stands there
        known.misses = misses
        return known.where(kept)

    def _shrink(self, unseen: Mask) -> None:
        """Let unknown space come nearer in the unseen directions (n,)."""
        nearer = (INTRUSION_SPEED + max(self.speed, 0.0)) * self._dt
        shrunk = np.maximum(self._known - nearer, LEAST_KNOWN)
        self._known = np.where(unseen, shrunk, max(self._reach, LEAST_KNOWN))
        self.frontier = self._place(self._known)[unseen]


def _may_walk(track: Track) -> bool:
    """Whether a cluster is as narrow and as slow as a person."""
    pace = math.hypot(*track.velocity.tolist())
    return track.width < PERSON_WIDTH and (track.sightings < FIRM or pace < PERSON_SPEED)


def _narrow_runs(points: Array) -> list[Array]:
    """Runs of points (n, 2) in the order of their beams that are as narrow as people."""
    ends = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > RUN) + 1
    runs = np.split(points, ends) if len(points) else []
    return [run for run in runs if math.dist(run[0], run[-1]) < PERSON_WIDTH]


def _near(points: Array, others: Array, reach: float) -> Mask:
    """Which of points (n, 2) have one of others (m, 2) within reach [m]."""
    if not len(others):
        return np.zeros(len(points), np.bool_)
    apart = points[:, None] - others
    return np.asarray((apart * apart).sum(axis=2).min(axis=1) < reach * reach)


def _looks_past(measured: Array) -> Mask:
    """Beside which beams (n,) [m] those to their right, and to their left, go further (2, n)."""
    count, edge = len(measured), np.zeros(LOOKED_PAST)
    beside = np.lib.stride_tricks.sliding_window_view(
        np.concatenate([edge, measured, edge]), LOOKED_PAST
    ).min(axis=1)
    return np.stack([beside[:count], beside[-count:]]) > measured + NEAR


def _nearby(beams: Mask) -> Mask:
    """Directions (n,) that one of `beams` (n,) covers."""
    covered = beams.copy()
    for shift in range(1, COVERED_BY + 1):
        covered[shift:] |= beams[:-shift]
        covered[:-shift] |= beams[shift:]
    return covered
