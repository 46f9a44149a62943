"""How a pedestrian crosses: he looks before he steps onto the ego's lanes, then walks on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from irl_dal.envs.road import HALF_WIDTH

PAVEMENT = 1.5
"""Distance from the edge of the road at which he waits and where he arrives [m]."""

COMFORTABLE = 2.0
"""Deceleration at which the ego must be able to stop for him [m/s^2]."""

MARGIN = 7.0
"""Distance that is then left between them [m]."""

REFUGE = 0.9
"""How far from the ego's lanes he waits where he has come from the other side [m]."""


@dataclass(frozen=True, slots=True)
class Crossing:
    """A way across the road.

    Attributes:
        start: `d` where he waits [m].
        goal: `d` where he arrives [m].
        speed: [m/s]
        notice: Distance of the ego's bumper at which he would like to be at its lanes [m].
    """

    start: float
    goal: float
    speed: float
    notice: float

    def pace(self, d: float, gap: float, ego_speed: float, *, wait: bool) -> float:
        """Sideways speed now [m/s], positive to the left.

        Args:
            d: Where he is [m].
            gap: From the ego's bumper to his way [m]; negative once it has passed.
            ego_speed: [m/s]
            wait: Another car is too near.
        """
        way = 1.0 if self.goal > self.start else -1.0
        if way * (self.goal - d) <= 0.0:
            return 0.0
        entry = -HALF_WIDTH - 0.5 if way > 0.0 else REFUGE
        before = way * (entry - d)
        if before < 0.0:
            return way * self.speed
        lead = 8.0 * before / self.speed
        if d == self.start and (gap > self.notice + lead or gap < 0.0):
            return 0.0
        stopping = ego_speed**2 / (2.0 * COMFORTABLE) + MARGIN
        waits_for_him = ego_speed < 0.5 and gap > 2.0
        clear = gap > stopping or gap < -8.0 or waits_for_him
        if before <= 0.2 and (wait or not clear):
            return 0.0
        return way * self.speed


def draw_crossing(rng: np.random.Generator, left_edge: float) -> Crossing:
    """Draw a side, a speed of 1 to 1.5 m/s and a moment.

    Args:
        rng: Source of the draws.
        left_edge: `d` of the road's left-hand edge [m].
    """
    sides = (-HALF_WIDTH - PAVEMENT, left_edge + PAVEMENT)
    start, goal = sides if rng.random() < 0.6 else sides[::-1]
    return Crossing(start, goal, float(rng.uniform(1.0, 1.5)), float(rng.uniform(30.0, 40.0)))
