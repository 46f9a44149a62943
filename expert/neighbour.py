"""The vehicle that is overtaken, also while it is beside the car, where the LiDAR sees nothing."""

import math
from collections import deque

import numpy as np

MEMORY = 10  # [steps] that the speed is fitted to: one second
MIN_SIGHTINGS = 5  # [steps] before there is a speed
MAX_JUMP = 1.0  # [m] a nearest point that moves further in a step belongs to something else
FLANK_GAP = 1.0  # [m] gap below which the nearest point may be a flank instead of the rear
BESIDE_GAP = 3.0  # [m] a vehicle lost at a smaller gap is beside the car
MAX_SPEED = 6.0  # [m/s] of a vehicle that is overtaken
MARGIN = 1.0  # [m] behind the rear bumper when the two lanes begin to overlap
CHANGE_TIME = 0.7  # [s] from the beginning of a lane change until the lanes overlap


class Neighbour:
    """The nearest vehicle in the home lane, and the one that went out of sight beside the car.

    From a gap `clear` [m] the home lane counts as free; `hold` [m] is the least distance to drive
    with it free before going back, `length` [m] the car's, `dt` [s] the time between two scans.
    """

    def __init__(self, clear: float, hold: float, dt: float, length: float) -> None:
        self._clear = clear
        self._hold = hold
        self._dt = dt
        self._length = length
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._places: deque[float] = deque(maxlen=MEMORY)
        self._gap = math.inf
        self._driven = self._free_for = 0.0
        self.speed = self._lost_speed = 0.0  # Of the nearest vehicle, along the lane [m/s]
        self.behind = math.inf  # Bumper ahead of the vehicle last lost beside the car [m]

    def update(self, gap: float, speed: float) -> None:
        """Take the `gap` [m] to the nearest point in the home lane and the car's `speed` [m/s]."""
        self._driven += speed * self._dt
        self._free_for = 0.0 if gap < self._clear else self._free_for + speed * self._dt
        change = gap - self._gap + (speed - self.speed) * self._dt
        if math.isfinite(self._gap) and abs(change) > MAX_JUMP:
            if self._gap < BESIDE_GAP:
                self._lost_speed, self.behind = self.speed, 0.0
            self.speed = 0.0
            self._places.clear()
        self.behind = max(0.0, self.behind + (speed - self._lost_speed) * self._dt)
        self._gap = gap
        if math.isfinite(gap) and gap > FLANK_GAP:
            self._places.append(self._driven + gap)
        if len(self._places) >= MIN_SIGHTINGS:
            time = self._dt * (np.arange(len(self._places)) - 0.5 * (len(self._places) - 1))
            slope = float(time @ np.array(self._places)) / float(time @ time)
            self.speed = min(max(slope, 0.0), MAX_SPEED)

    def passed(self, speed: float) -> bool:
        """Whether the car, at `speed` [m/s], can begin to go back to a free home lane."""
        gained = max(0.0, speed - self._lost_speed) * CHANGE_TIME
        return self._free_for > self._hold and self.behind > self._length + MARGIN - gained
