"""Where the rear of a tracked vehicle is along the lane, and how fast it goes."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

REARS = 10  # [scans] that the speed of a vehicle is fitted to: one second
REAR_JUMP = 1.0  # [m] a rear that moves further in a scan belongs to something else
FIRM, FAIR = 6, 3  # sightings from which a velocity is firm, or worth something


@dataclass(slots=True)
class Rear:
    """The rear of a tracked vehicle along the lane, and the speed that follows from it.

    The middle of what is seen of a standing vehicle moves as its flank comes into view; its rear
    does not.
    """

    places: deque[float] = field(default_factory=lambda: deque(maxlen=REARS))
    pace: float = 0.0
    wide: bool = False  # whether seen wider than a person, and not as a whole narrower since

    def see(self, place: float, dt: float) -> None:
        """Take its place along the lane [m]."""
        if self.places and abs(place - self.places[-1] - self.pace * dt) > REAR_JUMP:
            self.places.clear()
            self.pace = 0.0
        self.places.append(place)
        if len(self.places) >= FAIR:
            time = dt * (np.arange(len(self.places)) - 0.5 * (len(self.places) - 1))
            self.pace = float(time @ np.array(self.places)) / float(time @ time)
