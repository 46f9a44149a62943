"""A pedestrian's way across the road: wait for a gap at the ego's lanes, then walk on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from irl_dal.envs.road import HALF_WIDTH

__all__ = ["COMFORTABLE", "Crossing", "draw_crossing"]

PAVEMENT = 1.5  # Distance of start and goal from the edges of the road [m]
COMFORTABLE = 2.0  # Deceleration at which the ego must be able to stop before the crossing [m/s^2]
MARGIN = 7.0  # Distance that is then left to the crossing [m]
# Distance from the ego's lanes at which a pedestrian waits on its own side, and coming from the
# other side [m]
KERB, REFUGE = 0.5, 0.9
# The ego has passed this far beyond a crossing [m]; below this speed [m/s], and further from the
# crossing than this [m], it stands to let the pedestrian cross
EGO_PASSED, EGO_STANDS, EGO_WAITS = 8.0, 0.5, 2.0
REACHED = 0.2  # Within this distance of the ego's lanes a pedestrian stops if it has to wait [m]
EGO_SPEED = 8.0  # Speed of the ego that a pedestrian expects [m/s]: how early it sets off
FROM_THE_RIGHT = 0.6  # Probability that a pedestrian starts on the ego's side
# Range of walking speeds [m/s] and of distances to the ego at which the lanes are reached [m]
SPEEDS, NOTICES = (1.0, 1.5), (30.0, 40.0)


@dataclass(frozen=True, slots=True)
class Crossing:
    """A way across the road."""

    start: float  # `d` at the beginning [m]
    goal: float  # `d` at the end [m]
    speed: float  # [m/s]
    notice: float  # Distance of the ego's bumper when the pedestrian should reach its lanes [m]

    def pace(self, d: float, gap: float, ego_speed: float, *, wait: bool) -> float:
        """Sideways speed [m/s], positive to the left, at offset `d` [m].

        `gap` leads from the ego's bumper to the crossing [m], negative once it has passed; `wait`
        says that another car is too near.
        """
        way = 1.0 if self.goal > self.start else -1.0
        if way * (self.goal - d) <= 0.0:
            return 0.0
        entry = -HALF_WIDTH - KERB if way > 0.0 else REFUGE
        before = way * (entry - d)
        if before < 0.0:
            return way * self.speed
        lead = EGO_SPEED * before / self.speed
        if d == self.start and (gap > self.notice + lead or gap < 0.0):
            return 0.0
        stopping = ego_speed**2 / (2.0 * COMFORTABLE) + MARGIN
        ego_waits = ego_speed < EGO_STANDS and gap > EGO_WAITS
        clear = gap > stopping or gap < -EGO_PASSED or ego_waits
        if before <= REACHED and (wait or not clear):
            return 0.0
        return way * self.speed


def draw_crossing(rng: np.random.Generator, left_edge: float) -> Crossing:
    """Draw a side, a speed and a distance to the ego; `left_edge` is the edge's `d` [m]."""
    sides = (-HALF_WIDTH - PAVEMENT, left_edge + PAVEMENT)
    start, goal = sides if rng.random() < FROM_THE_RIGHT else sides[::-1]
    return Crossing(start, goal, float(rng.uniform(*SPEEDS)), float(rng.uniform(*NOTICES)))
