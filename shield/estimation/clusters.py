"""Small things that a scan sees, followed from scan to scan.

A cluster is a run of neighbouring beams whose points lie close together. Narrow ones (people,
poles, barrels) keep their shape from all sides, so the mean of their points is a place that can be
followed. Places are kept in an odometry frame, in which what stands still stands still; the
velocity is the slope of the line fitted to them over time.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from shield.arguments import check_positive
from shield.errors import InvalidProblem

__all__ = ["ClusterTracker", "Track"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Track:
    """A narrow cluster of the newest scan.

    Attributes:
        number: The same for the same thing, as long as it is followed.
        position: Mean of its points (2,), in the frame of the points [m].
        velocity: Over the ground (2,), along the axes of that frame [m/s]; 0 after one sighting.
        sightings: Places that the velocity comes from.
        first: Its first point, as a row of the points.
        last: Its last point.
    """

    number: int
    position: Array
    velocity: Array
    sightings: int
    first: int
    last: int


@dataclass(slots=True)
class _Follow:
    """The places of a cluster in the odometry frame, and how many scans missed it since."""

    number: int
    places: deque[tuple[float, float]]
    missed: int = 0


@dataclass(slots=True)
class ClusterTracker:
    """Follows narrow clusters.

    Attributes:
        dt: Time between two scans [s].
        forward: From the rear axle to the origin of the points [m].
        width: Clusters at least so wide are not followed [m].
        separation: Distance between neighbouring points that ends a cluster [m].
        reach: How far a cluster may move between two scans [m].
        memory: Places kept of each.
        patience: Scans in a row that may miss a cluster.

    Raises:
        InvalidProblem: A length or time is not positive.
    """

    dt: float
    forward: float
    width: float = 1.0
    separation: float = 0.8
    reach: float = 0.9
    memory: int = 10
    patience: int = 3
    _pose: Array = field(init=False)
    _follows: list[_Follow] = field(init=False)
    _count: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        check_positive(
            InvalidProblem,
            dt=self.dt,
            width=self.width,
            separation=self.separation,
            reach=self.reach,
            memory=self.memory,
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._pose = np.zeros(3)
        self._follows = []

    def update(self, points: Array, speed: float, yaw_rate: float) -> list[Track]:
        """Take a scan.

        Args:
            points: Hits (n, 2) in the order of the beams, x ahead, y to the left [m].
            speed: Since the last scan [m/s].
            yaw_rate: Since the last scan [rad/s].

        Returns:
            The narrow clusters of this scan.
        """
        self._move(speed, yaw_rate)
        for follow in self._follows:
            follow.missed += 1
        tracks = [self._track(points, low, high) for low, high in self._clusters(points)]
        self._follows = [follow for follow in self._follows if follow.missed <= self.patience]
        return tracks

    def _move(self, speed: float, yaw_rate: float) -> None:
        x, y, yaw = self._pose
        middle = yaw + 0.5 * yaw_rate * self.dt
        way = speed * self.dt
        self._pose = np.array(
            [x + way * math.cos(middle), y + way * math.sin(middle), yaw + yaw_rate * self.dt]
        )

    def _clusters(self, points: Array) -> list[tuple[int, int]]:
        """First row and row after the last of every narrow cluster."""
        if not len(points):
            return []
        jumps = np.hypot(*np.diff(points, axis=0).T) > self.separation
        bounds = np.concatenate([[0], np.flatnonzero(jumps) + 1, [len(points)]])
        low, high = bounds[:-1], bounds[1:]
        narrow = np.hypot(*(points[high - 1] - points[low]).T) < self.width
        return list(zip(low[narrow].tolist(), high[narrow].tolist(), strict=True))

    def _track(self, points: Array, low: int, high: int) -> Track:
        """Match a cluster with what was followed, or begin to follow it."""
        position = points[low:high].mean(axis=0)
        x, y, yaw = self._pose.tolist()
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead, left = float(position[0]) + self.forward, float(position[1])
        place = (x + cos * ahead - sin * left, y + sin * ahead + cos * left)
        follow = self._match(place)
        follow.places.append(place)
        follow.missed = 0
        east, north = self._slope(follow.places)
        velocity = np.array([cos * east + sin * north, cos * north - sin * east])
        return Track(follow.number, position, velocity, len(follow.places), low, high - 1)

    def _match(self, place: tuple[float, float]) -> _Follow:
        near = [
            (distance, follow)
            for follow in self._follows
            if follow.missed and (distance := math.dist(follow.places[-1], place)) < self.reach
        ]
        if near:
            return min(near, key=lambda pair: pair[0])[1]
        follow = _Follow(self._count, deque(maxlen=self.memory))
        self._count += 1
        self._follows.append(follow)
        return follow

    def _slope(self, places: deque[tuple[float, float]]) -> tuple[float, float]:
        """Least-squares velocity in the odometry frame [m/s]."""
        count = len(places)
        middle = 0.5 * (count - 1)
        spread = self.dt * sum((index - middle) ** 2 for index in range(count))
        if count < 2:
            return 0.0, 0.0
        east = sum((index - middle) * place[0] for index, place in enumerate(places))
        north = sum((index - middle) * place[1] for index, place in enumerate(places))
        return east / spread, north / spread
