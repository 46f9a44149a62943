"""What is around the car, as one scanner in the front bumper knows it.

The scanner looks ahead only. What has gone out of its view beside the car is remembered and moved
with its own velocity until the car has left it behind.

A beam that measures nothing says nothing: its direction is unknown, not free. There the last
occupancy is remembered, moved with the car, and the distance up to which the way was seen free
shrinks with every period until the car has to stand. What the scanner reports next replaces both.
A scan that repeats an earlier one bit by bit while the car drives measures nothing either. A scan
without a single return is believed, except that obstacles in full view do not vanish all at once:
they are remembered until the car has passed them or the scanner sees anything again.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.errors import Array, Mask, as_array, check_numbers
from shield.estimation.clusters import ClusterTracker, Track
from shield.estimation.scan import ScanFilter, ScannerGeometry

__all__ = ["Surroundings"]

MAX_PEDESTRIAN_WIDTH = 1.0  # [m] wider clusters are vehicles or walls
PEDESTRIAN_SPEED = 0.5, 2.5  # [m/s] slowest and fastest
MIN_SIGHTINGS = 5  # scans from which a track's velocity counts
MAX_VEHICLE_LENGTH = 7.0  # [m] longer clusters are walls and hedges, which stand
MAX_TRACK_SPEED = 15.0  # [m/s] along the car; more is a mismatch of two clusters
MEMORY_WIDTH = 3.5  # [m] sideways distance up to which obstacles beside the car are remembered
MEMORY_AHEAD = 2.0  # [m] obstacles nearer than this ahead may be beside the car in the next scan
COVERED_BY = 2  # beams to each side, one of which has to work for a direction to be seen
MIN_RETURNS = 5  # hits in view that cannot vanish all at once
INTRUSION_SPEED = 5.0  # [m/s] of traffic that may enter unseen space
LEAST_KNOWN = 2.0  # [m] nearer to the scanner unseen space does not come; inside the standoff


@dataclass(frozen=True, slots=True)
class _Motion:
    """How the car moved in one period `dt` [s], and where its scanner is mounted [m]."""

    speed: float
    turn: float
    mount: float
    dt: float

    def carry(self, points: Array, velocity: Array) -> Array:
        """Points (n, 2) in the frame of the new scan; they move with `velocity` (n, 2) [m/s]."""
        ahead = points[:, 0] + self.mount + (velocity[:, 0] - self.speed) * self.dt
        left = points[:, 1] + velocity[:, 1] * self.dt
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        return np.stack([cos * ahead + sin * left - self.mount, cos * left - sin * ahead], axis=1)

    def carry_track(self, track: Track) -> Track:
        """A track that was not seen in the new scan."""
        (position,) = self.carry(track.position[None], track.velocity[None])
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        x, y = track.velocity.tolist()
        velocity = np.array([cos * x + sin * y, cos * y - sin * x])
        return replace(track, position=position, velocity=velocity)


class Surroundings:
    """Points and pedestrians ahead, what is beside the car, and where nothing is known.

    Args:
        dt: Period of the scans [s].
        scanner: Where it is and where its beams point.
        reach: How far the points are of interest [m].

    Attributes:
        points: Obstacle points (n, 2) in the scanner's frame, x ahead, y to the left [m]: hits of
            the newest scan, and remembered ones in directions that it did not see.
        pedestrians: Tracks of pedestrians.
        beside: Remembered hits (m, 2) in the same frame, x < 0 [m].
        frontier: Where unknown space begins (k, 2), in the directions that were not seen [m].
        speed: Own speed [m/s].
    """

    def __init__(self, dt: float, scanner: ScannerGeometry, reach: float) -> None:
        self.scanner = scanner
        self._dt = dt
        self._reach = min(scanner.max_range - 0.5, reach)
        self._angles = scanner.angles
        self._rays = np.stack([np.cos(self._angles), np.sin(self._angles)], axis=1)
        self._tracker = ClusterTracker(dt, scanner.mount, width=MAX_VEHICLE_LENGTH)
        self._scan_filter = ScanFilter(scanner.max_range)
        self.reset()

    def reset(self) -> None:
        """Forget the episode; before the first scan nothing is known."""
        self._tracker.reset()
        self._scan_filter.reset()
        self.points: Array = np.zeros((0, 2))
        self.pedestrians: tuple[Track, ...] = ()
        self.beside: Array = np.zeros((0, 2))
        self.speed = 0.0
        self._pace: Array = np.zeros(0)
        self._beside_pace: Array = np.zeros(0)
        self._known: Array = np.full(self.scanner.beams, LEAST_KNOWN)
        self.frontier: Array = self._known[:, None] * self._rays

    def update(self, scan: ArrayLike, speed: float, yaw_rate: float) -> None:
        """Take a scan.

        Args:
            scan: Ranges of the scanner's beams [m], shape (n,), as in `ScanFilter.examine`.
            speed: Own speed since the last scan [m/s]; the last known one if not finite.
            yaw_rate: Own yaw rate since the last scan [rad/s]; 0 if not finite.

        Raises:
            InvalidProblem: An argument is not of numbers, or `scan` not of the scanner's shape.
        """
        ranges = as_array("scan", scan, (self.scanner.beams,))
        check_numbers(speed=speed, yaw_rate=yaw_rate)
        self.speed = float(speed) if math.isfinite(speed) else self.speed
        yaw_rate = float(yaw_rate) if math.isfinite(yaw_rate) else 0.0
        motion = _Motion(self.speed, yaw_rate * self._dt, self.scanner.mount, self._dt)
        clean = self._scan_filter.examine(ranges, self.speed)
        unseen = np.full(ranges.shape, clean.frozen) | ~_nearby(clean.working)
        points, pace = self._carry(motion)
        tracks = [motion.carry_track(track) for track in self.pedestrians]
        hits = self.scanner.returned(clean.ranges)
        # All that returns repeats the last scan although the car drove, or nothing returns although
        # something in view should.
        repeated = bool(hits.any() and clean.repeated[hits].all())
        blank = not hits.any() and (self._beam_of(points) >= 0).sum() >= MIN_RETURNS
        doubtful = unseen | repeated | blank | ~_nearby(~clean.repeated)
        hit = (clean.ranges < self._reach) & (not repeated)
        self._take(clean.ranges[hit, None] * self._rays[hit], yaw_rate)
        self._keep(points, pace, tracks, doubtful)
        self._shrink(unseen)

    def _beam_of(self, points: Array) -> NDArray[np.int64]:
        """Nearest beam of points (n, 2); -1 out of view."""
        angle = np.arctan2(points[:, 1], points[:, 0])
        spacing = self._angles[1] - self._angles[0]
        beam = np.rint((angle - self._angles[0]) / spacing).astype(np.int64)
        return np.where((beam >= 0) & (beam < len(self._angles)), beam, -1)

    def _carry(self, motion: _Motion) -> tuple[Array, Array]:
        """Move what is known by one period; return the points ahead and their speeds [m/s]."""
        near = (self.points[:, 0] < MEMORY_AHEAD) & (np.abs(self.points[:, 1]) < MEMORY_WIDTH)
        pace = np.concatenate([self._beside_pace, self._pace[near]])
        beside = motion.carry(np.concatenate([self.beside, self.points[near]]), _along(pace))
        # What is ahead of the scanner is seen anew.
        kept = (beside[:, 0] < 0.0) & (beside[:, 0] > -self.scanner.mount)
        self.beside, self._beside_pace = beside[kept], pace[kept]
        # Unseen, a leading vehicle may brake: it counts as standing.
        approach = np.minimum(self._pace, 0.0)
        return motion.carry(self.points, _along(approach)), approach

    def _take(self, points: Array, yaw_rate: float) -> None:
        """Replace points and pedestrians by those of a scan."""
        self.points = points
        tracks = self._tracker.update(self.points, self.speed, yaw_rate)
        tracks = [track for track in tracks if track.sightings >= MIN_SIGHTINGS]
        self._pace = np.zeros(len(self.points))
        for track in tracks:
            pace = float(track.velocity[0])
            moving = abs(pace) < MAX_TRACK_SPEED
            self._pace[track.first : track.last + 1] = pace if moving else 0.0
        self.pedestrians = tuple(track for track in tracks if self._is_pedestrian(track))

    def _is_pedestrian(self, track: Track) -> bool:
        width = math.dist(self.points[track.first], self.points[track.last])
        slowest, fastest = PEDESTRIAN_SPEED
        moves = slowest < math.hypot(*track.velocity.tolist()) < fastest
        return width < MAX_PEDESTRIAN_WIDTH and moves

    def _keep(self, points: Array, pace: Array, tracks: list[Track], doubtful: Mask) -> None:
        """Add what was known in directions (n,) that the scan says nothing about."""
        if not doubtful.any():
            return
        beam = self._beam_of(points)
        kept = (beam >= 0) & doubtful[beam]
        self.points = np.concatenate([self.points, points[kept]])
        self._pace = np.concatenate([self._pace, pace[kept]])
        for track in tracks:
            (beam,) = self._beam_of(track.position[None])
            if beam >= 0 and doubtful[beam]:
                self.pedestrians += (track,)

    def _shrink(self, unseen: Mask) -> None:
        """Let unknown space come nearer in the unseen directions (n,)."""
        nearer = (INTRUSION_SPEED + max(self.speed, 0.0)) * self._dt
        shrunk = np.maximum(self._known - nearer, LEAST_KNOWN)
        self._known = np.where(unseen, shrunk, max(self._reach, LEAST_KNOWN))
        self.frontier = self._known[unseen, None] * self._rays[unseen]


def _nearby(beams: Mask) -> Mask:
    """Directions (n,) that one of `beams` (n,) covers."""
    padded = np.pad(beams, COVERED_BY)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * COVERED_BY + 1)
    return np.asarray(windows.any(axis=1), dtype=np.bool_)


def _along(pace: Array) -> Array:
    """Velocities (n, 2) of obstacles that move along the car at `pace` (n,) [m/s]."""
    return np.stack([pace, np.zeros_like(pace)], axis=1)
