"""Who crosses the road: narrow things that the LiDAR sees move, or standing where no barrel stands.

`shield.ClusterTracker` follows them in a frame that does not jump with the lane estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from expert.lane_map import LIDAR_FORWARD, LaneMap
from shield import ClusterTracker, Track

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
class _Judgement:
    """What is thought of a track so far."""

    person: bool = False
    way: float = 0.0


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


class CrossingWatch:
    """Tells who crosses from narrow clusters that are followed from scan to scan.

    Args:
        config: What counts as a pedestrian.
        dt: Time between two scans [s].
    """

    def __init__(self, config: CrossingConfig, dt: float) -> None:
        self.config = config
        self._tracker = ClusterTracker(
            dt,
            LIDAR_FORWARD,
            width=config.width,
            separation=config.separation,
            memory=config.memory,
        )
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._tracker.reset()
        self._judgements: dict[int, _Judgement] = {}

    def update(self, lanes: LaneMap, speed: float, yaw_rate: float) -> list[Pedestrian]:
        """Take a scan; pedestrians on the own direction's lanes and their edges.

        Args:
            lanes: The scan in the lanes.
            speed: Since the last scan [m/s].
            yaw_rate: Since the last scan [rad/s].
        """
        config, people = self.config, []
        for track in self._tracker.update(lanes.points, speed, yaw_rate):
            rows = slice(track.first, track.last + 1)
            s, d = float(lanes.s[rows].mean()), float(lanes.d[rows].mean())
            if not (-1.0 < s < config.reach and config.right - 2.0 < d < config.left + 2.0):
                continue
            judgement = self._judgements.setdefault(track.number, _Judgement())
            self._judge(judgement, track, (s, d), lanes.heading_at(s))
            if judgement.person and config.right < d < config.left:
                people.append(Pedestrian(s, d, judgement.way))
        return people

    def _judge(
        self, judgement: _Judgement, track: Track, place: tuple[float, float], heading: float
    ) -> None:
        """Decide whether a track is somebody who crosses, and which way he goes."""
        config, (s, d) = self.config, place
        forward, left = track.velocity.tolist()
        sideways = math.cos(heading) * left - math.sin(heading) * forward
        along = math.cos(heading) * forward + math.sin(heading) * left
        if track.sightings == config.memory and abs(along) < 1.5:
            if config.speed < abs(sideways) < 2.5:
                judgement.person = True
            if abs(sideways) > 0.5 * config.speed:
                judgement.way = math.copysign(1.0, sideways)
            else:
                judgement.person = False
        margin = config.aside + config.aside_growth * max(s, 0.0)
        if track.sightings >= 3 and abs(d) > margin and config.right < d < config.left:
            judgement.person = True
        if judgement.way == 0.0:
            judgement.way = 1.0 if d < 0.0 else -1.0
