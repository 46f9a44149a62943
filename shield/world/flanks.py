r"""The steering with which the flanks stay clear of what is beside the car.

On a circle of radius R to the right the flank at the rear axle is the innermost part of the car.
A thing at (x, y), x ahead of the rear axle and y to the right, stays inside of it if

.. math:: x^2 + (R - y)^2 \le (R - h)^2 \iff \kappa = \frac1R \le \frac{2 (y - h)}{x^2 + y^2 - h^2}

with h half the width of the car and a margin. To the left it is the same with the signs changed.
Straight on is always allowed.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from shield.arguments import check_positive
from shield.errors import InvalidLimits
from shield.world.surroundings import Surroundings

__all__ = ["FlankBarrier", "FlankConfig"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FlankConfig:
    """Numbers of the barrier, none of them in the paper.

    Attributes:
        half_width: Half the width of the car and a margin [m].
        reach: Sideways distance from the middle up to which a thing is beside the car [m].

    Raises:
        InvalidLimits: A number is not positive and finite.
    """

    half_width: float = 1.15
    reach: float = 2.2

    def __post_init__(self) -> None:
        """Refuse what cannot be, naming the field and the value received."""
        check_positive(InvalidLimits, **asdict(self))


class FlankBarrier:
    """Bounds the steering by what is beside the car.

    Args:
        config: Its numbers.
        wheelbase: Distance between the axles [m].
    """

    def __init__(self, config: FlankConfig, wheelbase: float) -> None:
        self.config = config
        self._wheelbase = wheelbase

    def steering(self, around: Surroundings) -> tuple[float, float]:
        """Sharpest admissible steering to the right (at most 0) and to the left (at least 0) [rad].

        Infinite on a side where nothing is.

        Args:
            around: What is there.
        """
        ahead, aside = around.beside[:, 0] + around.forward, around.beside[:, 1]
        return -self._sharpest(ahead, -aside), self._sharpest(ahead, aside)

    def _sharpest(self, ahead: Array, aside: Array) -> float:
        """Sharpest steering towards a side, from points at distances ahead and aside (n,) [m]."""
        half = self.config.half_width
        on_side = (aside > 0.0) & (aside < self.config.reach)
        if not on_side.any():
            return math.inf
        x, y = ahead[on_side], aside[on_side]
        room = np.maximum(y - half, 0.0)
        curvature = 2.0 * room / np.maximum(x**2 + y**2 - half**2, 1e-6)
        return math.atan(self._wheelbase * float(curvature.min()))
