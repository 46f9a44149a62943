"""Pedestrians: narrow clusters that move sideways, or stand where no barrel stands."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from expert.lane_map import LaneMap
from shield import Track
from shield.estimation.clusters import MEMORY, SEPARATION
from shield.world.world import PERSON_WIDTH

GRAZE = 4.5  # [m] to something wide within which a single hit is its flank: beams along it hit it
# metres apart, while a pedestrian so near that it matters is two beams wide
MIN_SIGHTINGS = 3  # [scans] before a place alone is evidence
FORGET_AFTER = 10  # [scans] without a sighting; the tracker gives up earlier
MAX_DISTANCE = 34.0  # [m] further ahead a pedestrian is one or two beams wide
BEHIND = -1.0  # [m] from the bumper; further back the scanner sees nothing
RIGHT_END, LEFT_END = -2.0, 5.4  # [m] both lanes and their edges, from the home lane's centre
APPROACH = 2.0  # [m] beside that zone in which clusters are already judged
MAX_ALONG_SPEED = 1.5  # [m/s] along the lane; faster clusters are vehicles
MIN_SIDEWAYS_SPEED = 0.6  # [m/s] from which a narrow cluster is a pedestrian
MAX_SIDEWAYS_SPEED = 2.5  # [m/s] faster than a pedestrian crosses: a false match
BARREL_ZONE = 1.05  # [m] from the home lane's centre; no barrel stands further aside
BARREL_ZONE_GROWTH = 0.02  # [m/m] of distance ahead, because the lane is uncertain there
FAST_WALK = 1.5  # [m/s] assumed of a pedestrian who has not reached the car's path yet
ROOM = 1.9  # [m] sideways distance at which a pedestrian is out of the way
STANDOFF = 1.5  # [m] added to the usual distance in front of a pedestrian
PASSED = 6.0  # [m] from the front bumper to behind the car, with a margin
MIN_PASSING_SPEED = 3.0  # [m/s] so that a car that has stopped drives on in front of a far one


@dataclass(slots=True)
class _Judgement:
    """What is known of a track."""

    seen: int  # Number of the last scan that showed it
    pedestrian: bool = False  # Whether it is one
    direction: float = 0.0  # +1 when it moves to the left, -1 to the right, 0 while that is unknown


@dataclass(frozen=True, slots=True)
class Pedestrian:
    """A pedestrian who crosses."""

    s: float  # Distance along the lane from the bumper [m]
    d: float  # Offset to the left of the home lane's centre [m]
    direction: float  # +1 for a pedestrian walking to the left, -1 to the right

    def blocks(self, offset: float, speed: float) -> bool:
        """Whether the pedestrian is in the car's path, or will be before it has passed.

        The car drives at `offset` [m] with `speed` [m/s].
        """
        past = self.direction * (self.d - offset)
        if past > ROOM:
            return False
        arrives = max(0.0, -past - ROOM) / FAST_WALK
        return arrives < (self.s + PASSED) / max(speed, MIN_PASSING_SPEED)


class CrossingWatch:
    """Tells pedestrians from other narrow clusters that are followed from scan to scan."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._scans = 0
        self._judgements: dict[int, _Judgement] = {}

    def update(self, lanes: LaneMap, tracks: Sequence[Track]) -> list[Pedestrian]:
        """Take a scan's map and tracks; pedestrians on the own direction's lanes and their edges.

        The rows of the tracks are those of the map.
        """
        self._scans += 1
        people = []
        for track in tracks:
            if track.width >= PERSON_WIDTH:
                continue
            rows = slice(track.first, track.last + 1)
            s, d = float(lanes.s[rows].mean()), float(lanes.d[rows].mean())
            near = RIGHT_END - APPROACH < d < LEFT_END + APPROACH
            beside = (np.abs(lanes.s - s) < GRAZE) & (np.abs(lanes.d - d) < SEPARATION)
            flank = track.first == track.last and np.count_nonzero(beside) > 1
            if flank or not (BEHIND < s < MAX_DISTANCE and near):
                continue
            judgement = self._judgements.setdefault(track.number, _Judgement(self._scans))
            judgement.seen = self._scans
            self._judge(judgement, track, (s, d), lanes.heading_at(s))
            if judgement.pedestrian and RIGHT_END < d < LEFT_END:
                people.append(Pedestrian(s, d, judgement.direction))
        self._judgements = {
            number: judgement
            for number, judgement in self._judgements.items()
            if self._scans - judgement.seen < FORGET_AFTER
        }
        return people

    def _judge(
        self, judgement: _Judgement, track: Track, place: tuple[float, float], heading: float
    ) -> None:
        """Decide whether a track is a pedestrian, and in which direction it crosses."""
        s, d = place
        forward, left = track.velocity.tolist()
        sideways = math.cos(heading) * left - math.sin(heading) * forward
        along = math.cos(heading) * forward + math.sin(heading) * left
        if track.sightings == MEMORY and abs(along) < MAX_ALONG_SPEED:
            if MIN_SIDEWAYS_SPEED < abs(sideways) < MAX_SIDEWAYS_SPEED:
                judgement.pedestrian = True
            if abs(sideways) > 0.5 * MIN_SIDEWAYS_SPEED:
                judgement.direction = math.copysign(1.0, sideways)
            else:
                judgement.pedestrian = False
        barrels = BARREL_ZONE + BARREL_ZONE_GROWTH * max(s, 0.0)
        if track.sightings >= MIN_SIGHTINGS and abs(d) > barrels and RIGHT_END < d < LEFT_END:
            judgement.pedestrian = True
        if judgement.direction == 0.0:
            judgement.direction = 1.0 if d < 0.0 else -1.0
