"""Bursts of wrong commands while the expert drives, so that it shows how to recover.

An expert that is never off its way teaches nothing about coming back to it, and the cloned policy
drifts (covariate shift). Noise in the demonstrations, with the clean label kept, is the remedy of
Laskey et al., "DART: Noise Injection for Robust Imitation Learning" (CoRL 2017, arXiv 1703.09327).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Disturbance", "DisturbanceConfig"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DisturbanceConfig:
    """How often and how far the expert's command is pushed aside (not in the paper).

    Strong enough that the car leaves its line by about half a metre, weak enough that the expert
    still reaches the goal in nine episodes of ten.

    Attributes:
        rate: Probability that a burst begins in a calm step; 0 for an undisturbed expert.
        steering: Largest offset of the steering [rad].
        slower: Largest offset of the speed downwards [m/s].
        faster: Largest offset of the speed upwards [m/s].
        shortest: Steps of the shortest burst.
        longest: Steps of the longest burst.
    """

    rate: float = 0.025
    steering: float = 0.08
    slower: float = 2.0
    faster: float = 1.0
    shortest: int = 4
    longest: int = 8

    def __post_init__(self) -> None:
        if not 0.0 <= self.rate <= 1.0:
            raise ValueError(f"`rate` must be in [0, 1]. Got {self.rate}.")
        for name in ("steering", "slower", "faster"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
        if not 1 <= self.shortest <= self.longest:
            raise ValueError(
                f"`shortest` must be in [1, `longest`]. Got {self.shortest} and {self.longest}."
            )


class Disturbance:
    """Draws the bursts.

    Args:
        config: How often and how far.
        rng: Source of the draws.
    """

    def __init__(self, config: DisturbanceConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._left = 0
        self._offset: Array = np.zeros(2)

    def step(self) -> Array | None:
        """Offset (2,) [rad, m/s] of this step's command; None in a calm step."""
        config, rng = self._config, self._rng
        if self._left == 0 and rng.random() < config.rate:
            self._left = int(rng.integers(config.shortest, config.longest + 1))
            self._offset = rng.uniform(
                (-config.steering, -config.slower), (config.steering, config.faster)
            )
        if self._left == 0:
            return None
        self._left -= 1
        return self._offset
