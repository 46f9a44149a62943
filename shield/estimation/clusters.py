"""Narrow clusters of a scan, tracked from scan to scan.

A cluster is a run of neighbouring beams whose points lie close together. Narrow clusters
(pedestrians, poles, barrels) look alike from all sides, so the mean of their points is a position
that can be tracked. Positions are kept in an odometry frame, in which standing objects rest; the
velocity is the slope of a line fitted to them over time.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from shield.errors import Array, InvalidProblem, as_array, check_numbers, check_positive

__all__ = ["ClusterTracker", "Track"]

SEPARATION = 0.8  # [m] between neighbouring points that ends a cluster
REACH = 0.9  # [m] that a cluster may move between two scans
MEMORY = 10  # [scans] that a velocity is fitted to: one second
MAX_MISSED_SCANS = 3  # in a row, after which a track ends


@dataclass(frozen=True, slots=True)
class Track:
    """A narrow cluster of the newest scan.

    Attributes:
        number: Identifies the object as long as it is tracked.
        position: Mean of its points (2,), in the frame of the points [m].
        velocity: Over the ground (2,), along the axes of that frame [m/s]; 0 after one sighting.
        sightings: Positions that the velocity comes from, at most `MEMORY`.
        first, last: Rows of its first and last point.
        width: Distance between those two [m].
    """

    number: int
    position: Array
    velocity: Array
    sightings: int
    first: int
    last: int
    width: float


@dataclass(slots=True)
class _History:
    """Positions of a cluster in the odometry frame, and how many scans missed it since."""

    number: int
    positions: deque[tuple[float, float]]
    missed: int = 0


@dataclass(slots=True)
class ClusterTracker:
    """Tracks narrow clusters.

    Attributes:
        dt: Time between two scans [s].
        mount: From the rear axle to the origin of the points [m].
        width: Clusters at least so wide are not tracked [m].

    Raises:
        InvalidProblem: A length or time is not positive.
    """

    dt: float
    mount: float
    width: float = 1.0
    _pose: tuple[float, float, float] = field(init=False)
    _histories: list[_History] = field(init=False)
    _count: int = field(init=False)

    def __post_init__(self) -> None:
        check_positive(InvalidProblem, dt=self.dt, width=self.width)
        self.reset()

    def reset(self) -> None:
        """Forget everything; numbers begin at 0 again."""
        self._pose = 0.0, 0.0, 0.0
        self._histories = []
        self._count = 0

    def update(self, points: Array, speed: float, yaw_rate: float) -> list[Track]:
        """Take a scan, and return its narrow clusters.

        Args:
            points: Hits (n, 2) in the order of the beams, x ahead, y to the left [m].
            speed: Since the last scan [m/s].
            yaw_rate: Since the last scan [rad/s].

        Raises:
            InvalidProblem: An argument is not of numbers, or `points` not (n, 2).
        """
        points = as_array("points", points)
        if points.ndim != 2 or points.shape[1] != 2:
            raise InvalidProblem(f"`points` must have shape (n, 2). Got {points.shape}.")
        check_numbers(speed=speed, yaw_rate=yaw_rate)
        self._move(speed, yaw_rate)
        for history in self._histories:
            history.missed += 1
        first, last, width = self._clusters(points)
        sizes = (last - first + 1)[:, None]
        # Every other sum is that of the points between two narrow clusters.
        bounds = np.stack([first, last + 1], axis=1).ravel()
        sums = np.add.reduceat(np.append(points, [[0.0, 0.0]], axis=0), bounds, axis=0)[::2]
        rows = zip(sums / sizes, first.tolist(), last.tolist(), width.tolist(), strict=True)
        tracks = [self._track(*row) for row in rows]
        self._histories = [
            history for history in self._histories if history.missed <= MAX_MISSED_SCANS
        ]
        return tracks

    def _move(self, speed: float, yaw_rate: float) -> None:
        x, y, yaw = self._pose
        middle = yaw + 0.5 * yaw_rate * self.dt
        driven = speed * self.dt
        ahead, left = driven * math.cos(middle), driven * math.sin(middle)
        self._pose = x + ahead, y + left, yaw + yaw_rate * self.dt

    def _clusters(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Rows (n,) of the first and last points of narrow clusters, and their widths (n,) [m]."""
        if not len(points):
            return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        steps = np.diff(points, axis=0)
        (ends,) = np.nonzero(np.hypot(steps[:, 0], steps[:, 1]) > SEPARATION)
        first, last = np.append(0, ends + 1), np.append(ends, len(points) - 1)
        across = points[last] - points[first]
        width = np.hypot(across[:, 0], across[:, 1])
        narrow = width < self.width
        return first[narrow], last[narrow], width[narrow]

    def _track(self, position: Array, first: int, last: int, width: float) -> Track:
        """Match a cluster with a track, or begin a new one."""
        x, y, yaw = self._pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead, left = float(position[0]) + self.mount, float(position[1])
        fixed = (x + cos * ahead - sin * left, y + sin * ahead + cos * left)
        history = self._match(fixed)
        history.positions.append(fixed)
        history.missed = 0
        east, north = self._slope(history.positions)
        velocity = np.array([cos * east + sin * north, cos * north - sin * east])
        count = len(history.positions)
        return Track(history.number, position, velocity, count, first, last, width)

    def _match(self, position: tuple[float, float]) -> _History:
        free = [history for history in self._histories if history.missed]
        pairs = [(math.dist(history.positions[-1], position), history) for history in free]
        near = [pair for pair in pairs if pair[0] < REACH]
        if near:
            return min(near, key=lambda pair: pair[0])[1]
        history = _History(self._count, deque(maxlen=MEMORY))
        self._count += 1
        self._histories.append(history)
        return history

    def _slope(self, positions: deque[tuple[float, float]]) -> tuple[float, float]:
        """Least-squares velocity in the odometry frame [m/s]."""
        count = len(positions)
        if count < 2:
            return 0.0, 0.0
        east = north = 0.0
        time = -0.5 * (count - 1)
        for x, y in positions:
            east += time * x
            north += time * y
            time += 1.0
        spread = self.dt * count * (count * count - 1) / 12.0
        return east / spread, north / spread
