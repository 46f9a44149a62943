"""Who crosses the road: narrow things that the LiDAR sees move, or standing where no barrel stands.

Clusters of the scan are followed in an odometry frame, which does not jump with the lane estimate.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from expert.lane_map import LIDAR_FORWARD, LaneMap

Array = NDArray[np.float64]

_FASTEST, _CAR = 1.5, 6.0  # m/s of a walker, m from the bumper to behind the car with a margin


@dataclass(frozen=True, slots=True)
class CrossingConfig:
    """What counts as a pedestrian, and what of him counts.

    Attributes:
        width: Clusters at least so wide are something else [m].
        separation: Distance between neighbouring points that ends a cluster [m].
        reach: Clusters further ahead are not followed [m].
        speed: Sideways speed from which a cluster crosses [m/s].
        aside: Distance from the home lane's centre at which no barrel stands [m].
        aside_growth: Added to `aside` for each metre of distance, because the lane is uncertain.
        right: Offset of the zone's right end, from the home lane's centre [m].
        left: Offset of its left end [m].
        memory: Length of the track that the speed comes from [steps].
        room: Sideways distance at which he is out of the way [m].
        standoff: Added to the usual distance in front of him [m].
    """

    width: float = 1.0
    separation: float = 0.8
    reach: float = 34.0
    speed: float = 0.6
    aside: float = 1.05
    aside_growth: float = 0.02
    right: float = -2.0
    left: float = 5.4
    memory: int = 10
    room: float = 1.9
    standoff: float = 1.5

    def __post_init__(self) -> None:
        for name in ("width", "separation", "reach", "speed", "room"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"`{name}` must be positive. Got {getattr(self, name)}.")
        if self.memory < 2:
            raise ValueError(f"`memory` must be at least 2. Got {self.memory}.")


@dataclass(slots=True)
class _Follow:
    """A cluster that is being followed, in the odometry frame."""

    places: deque[tuple[float, float]]
    person: bool = False
    way: float = 0.0
    lost: int = 0


@dataclass(frozen=True, slots=True)
class Pedestrian:
    """Somebody who crosses.

    Attributes:
        s: Distance along the lane from the bumper [m].
        d: Offset to the left of the home lane's centre [m].
        way: +1 when he goes to the left, -1 to the right.
    """

    s: float
    d: float
    way: float

    def blocks(self, offset: float, speed: float, room: float) -> bool:
        """Whether he is in the way of the car, or will be before it has passed.

        Args:
            offset: Where the car drives [m].
            speed: Of the car [m/s].
            room: Sideways distance at which he is out of the way [m].
        """
        past = self.way * (self.d - offset)
        if past > room:
            return False
        arrives = max(0.0, -past - room) / _FASTEST
        return arrives < (self.s + _CAR) / max(speed, 3.0)


@dataclass(slots=True)
class CrossingWatch:
    """Follows narrow clusters from scan to scan.

    Attributes:
        config: What counts as a pedestrian.
        dt: Time between two scans [s].
    """

    config: CrossingConfig
    dt: float
    _pose: Array = field(default_factory=lambda: np.zeros(3))
    _follows: list[_Follow] = field(default_factory=list)

    def reset(self) -> None:
        """Forget the episode."""
        self._pose = np.zeros(3)
        self._follows = []

    def update(self, lanes: LaneMap, speed: float, yaw_rate: float) -> list[Pedestrian]:
        """Take a scan; pedestrians on the own direction's lanes and their edges.

        Args:
            lanes: The scan in the lanes.
            speed: Since the last scan [m/s].
            yaw_rate: Since the last scan [rad/s].
        """
        x, y, yaw = self._pose
        middle = yaw + 0.5 * yaw_rate * self.dt
        self._pose = np.array(
            [
                x + speed * self.dt * math.cos(middle),
                y + speed * self.dt * math.sin(middle),
                yaw + yaw_rate * self.dt,
            ]
        )
        people = []
        for follow in self._follows:
            follow.lost += 1
        for s, d, point in self._narrow(lanes):
            follow = self._matching(self._world(point))
            self._judge(follow, s, d, lanes)
            if follow.person and self.config.right < d < self.config.left and s > -1.0:
                people.append(Pedestrian(s, d, follow.way))
        self._follows = [follow for follow in self._follows if follow.lost <= 3]
        return people

    def _narrow(self, lanes: LaneMap) -> list[tuple[float, float, Array]]:
        """Narrow clusters near the road: s, d and the point (2,) in the LiDAR's frame."""
        config, points = self.config, lanes.points
        if not len(points):
            return []
        jumps = np.linalg.norm(np.diff(points, axis=0), axis=1) > config.separation
        bounds = np.concatenate([[0], np.flatnonzero(jumps) + 1, [len(points)]])
        found = []
        for low, high in zip(bounds[:-1], bounds[1:], strict=True):
            s, d = float(lanes.s[low:high].mean()), float(lanes.d[low:high].mean())
            if not (-1.0 < s < config.reach and config.right - 2.0 < d < config.left + 2.0):
                continue
            if math.dist(points[low], points[high - 1]) < config.width:
                found.append((s, d, points[low:high].mean(axis=0)))
        return found

    def _world(self, point: Array) -> tuple[float, float]:
        x, y, yaw = self._pose
        ahead, left = float(point[0]) + LIDAR_FORWARD, float(point[1])
        cos, sin = math.cos(yaw), math.sin(yaw)
        return float(x + cos * ahead - sin * left), float(y + sin * ahead + cos * left)

    def _matching(self, place: tuple[float, float]) -> _Follow:
        """The cluster that was near this place before, or a new one."""
        near = [f for f in self._follows if f.lost and math.dist(f.places[-1], place) < 0.9]
        if not near:
            follow = _Follow(deque(maxlen=self.config.memory))
            self._follows.append(follow)
        else:
            follow = min(near, key=lambda f: math.dist(f.places[-1], place))
        follow.places.append(place)
        follow.lost = 0
        return follow

    def _judge(self, follow: _Follow, s: float, d: float, lanes: LaneMap) -> None:
        """Decide whether a cluster is somebody who crosses, and which way he goes."""
        config = self.config
        yaw = float(self._pose[2])
        heading = yaw + lanes.heading_at(s)
        sideways, along = _velocity(follow.places, heading, self.dt)
        if len(follow.places) == config.memory and abs(along) < 1.5:
            if config.speed < abs(sideways) < 2.5:
                follow.person = True
            if abs(sideways) > 0.5 * config.speed:
                follow.way = math.copysign(1.0, sideways)
            else:
                follow.person = False
        margin = config.aside + config.aside_growth * max(s, 0.0)
        if len(follow.places) >= 3 and abs(d) > margin and config.right < d < config.left:
            follow.person = True
        if follow.way == 0.0:
            follow.way = 1.0 if d < 0.0 else -1.0


def _velocity(
    places: Sequence[tuple[float, float]], heading: float, dt: float
) -> tuple[float, float]:
    """Speed to the left of and along a direction, the slope of the places over time [m/s]."""
    count = len(places)
    if count < 2:
        return 0.0, 0.0
    time = dt * (np.arange(count) - 0.5 * (count - 1))
    slope = time @ np.array(places) / float(time @ time)
    cos, sin = math.cos(heading), math.sin(heading)
    return float(cos * slope[1] - sin * slope[0]), float(cos * slope[0] + sin * slope[1])
