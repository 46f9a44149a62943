"""What the car overtakes, also while it is beside the doors, where the LiDAR does not look."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from expert.lane_map import BODY_LENGTH

_MEMORY = 10
"""Steps that the speed is taken from."""

_LEAST = 5
"""Steps without which there is no speed yet."""

_JUMP = 1.0
"""A nearest point that moves by more in a step belongs to something else [m]."""

_NEAR = 1.0
"""Gap below which the nearest point may be a flank instead of the rear [m]."""

_BESIDE = 3.0
"""What was nearer than this when it was lost is beside the car [m]."""

_FASTEST = 6.0
"""Of what is overtaken [m/s]."""

_MARGIN = 1.0
"""Free distance behind the rear bumper when the two lanes begin to overlap [m]."""

_CHANGE = 1.0
"""Time from the beginning of a lane change until the lanes overlap [s]."""


class Neighbour:
    """What is nearest in the home lane, and what went out of sight beside the car.

    Args:
        clear: Gap from which the home lane counts as free [m].
        hold: Least distance to drive with a free home lane before going back [m].
        dt: Time between two scans [s].

    Attributes:
        speed: Of what is nearest, along the lane [m/s].
        behind: How far the bumper has got ahead of what was last lost beside the car [m].
    """

    def __init__(self, clear: float, hold: float, dt: float) -> None:
        self._clear = clear
        self._hold = hold
        self._dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._places: deque[float] = deque(maxlen=_MEMORY)
        self._gap = math.inf
        self._driven = self._free_for = 0.0
        self.speed = self._lost_speed = 0.0
        self.behind = math.inf

    def update(self, gap: float, speed: float) -> None:
        """Take what the last scan says.

        Args:
            gap: From the bumper to the nearest point in the home lane [m]; infinite without any.
            speed: Of the car since the last scan [m/s].
        """
        self._driven += speed * self._dt
        self._free_for = 0.0 if gap < self._clear else self._free_for + speed * self._dt
        change = gap - self._gap + (speed - self.speed) * self._dt
        if math.isfinite(self._gap) and abs(change) > _JUMP:
            if self._gap < _BESIDE:
                self._lost_speed, self.behind = self.speed, 0.0
            self.speed = 0.0
            self._places.clear()
        self.behind = max(0.0, self.behind + (speed - self._lost_speed) * self._dt)
        self._gap = gap
        if math.isfinite(gap) and gap > _NEAR:
            self._places.append(self._driven + gap)
        if len(self._places) >= _LEAST:
            time = self._dt * (np.arange(len(self._places)) - 0.5 * (len(self._places) - 1))
            slope = float(time @ np.array(self._places)) / float(time @ time)
            self.speed = min(max(slope, 0.0), _FASTEST)

    def passed(self, speed: float) -> bool:
        """Whether the car, at `speed` [m/s], can begin to go back to a free home lane."""
        gained = max(0.0, speed - self._lost_speed) * _CHANGE
        return self._free_for > self._hold and self.behind > BODY_LENGTH + _MARGIN - gained
