"""Bursts of wrong commands while the expert drives, so that it shows how to recover.

An expert that never leaves its line does not show how to come back to it, and the cloned policy
drifts (covariate shift). Noise in the demonstrations, with the clean label kept, is the remedy of
Laskey et al., "DART: Noise Injection for Robust Imitation Learning" (CoRL 2017, arXiv 1703.09327).
"""

import numpy as np

from irl_dal.arrays import Array

# Strong enough that the car leaves its line by about half a metre, weak enough that the expert
# still reaches the goal in nine episodes of ten (measured; the paper does not disturb its expert).
LOWEST = (-0.08, -2.0)  # [rad, m/s] offset of steering and speed
HIGHEST = (0.08, 1.0)  # [rad, m/s] less upwards: a faster car is further from the expert's speed
DURATION = (4, 8)  # [steps] of a burst: 0.4 to 0.8 s, long enough to move the car


class Disturbance:
    """Draws the bursts of an episode; `rate` is the probability that one begins in a calm step."""

    def __init__(self, rng: np.random.Generator, rate: float) -> None:
        self._rng, self._rate, self._left = rng, rate, 0
        self._offset: Array = np.zeros(2)

    def step(self) -> Array | None:
        """Offset (2,) [rad, m/s] of this step's command; None in a calm step."""
        if self._left == 0 and self._rng.random() < self._rate:
            self._left = int(self._rng.integers(DURATION[0], DURATION[1] + 1))
            self._offset = self._rng.uniform(LOWEST, HIGHEST)
        if self._left == 0:
            return None
        self._left -= 1
        return self._offset
