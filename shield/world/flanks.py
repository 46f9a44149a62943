r"""The steering with which the flanks stay clear of what is beside the car.

On a circle of radius R to the right the flank at the rear axle is the innermost part of the car.
An obstacle at (x, y), x ahead of the rear axle and y to the right, stays inside of it if

.. math:: x^2 + (R - y)^2 \le (R - h)^2 \iff \kappa = \frac1R \le \frac{2 (y - h)}{x^2 + y^2 - h^2}

with h half the width of the car and a margin. To the left it is the same with the signs changed.
Straight on is always allowed.
"""

import math

import numpy as np

from shield.errors import Array
from shield.vehicle import VehicleGeometry
from shield.world.surroundings import Surroundings

__all__ = ["FLANK_MARGIN", "FlankBarrier"]

FLANK_MARGIN = 0.25  # [m] between the body and what it passes
FLANK_REACH = 1.3  # [m] beside the body up to which an obstacle bounds the steering


class FlankBarrier:
    """Bounds the steering by what is beside the car."""

    def __init__(self, vehicle: VehicleGeometry, wheelbase: float) -> None:
        self._half_width = 0.5 * vehicle.width + FLANK_MARGIN
        self._reach = 0.5 * vehicle.width + FLANK_REACH
        self._wheelbase = wheelbase

    def steering(self, around: Surroundings) -> tuple[float, float]:
        """Sharpest admissible steering to the right (at most 0) and to the left (at least 0) [rad].

        Infinite on a side where nothing is.
        """
        ahead, aside = around.beside[:, 0] + around.scanner.mount, around.beside[:, 1]
        return -self._sharpest(ahead, -aside), self._sharpest(ahead, aside)

    def _sharpest(self, ahead: Array, aside: Array) -> float:
        """Sharpest steering towards a side, from points at distances ahead and aside (n,) [m]."""
        half = self._half_width
        on_side = (aside > 0.0) & (aside < self._reach)
        if not on_side.any():
            return math.inf
        x, y = ahead[on_side], aside[on_side]
        room = np.maximum(y - half, 0.0)
        curvature = 2.0 * room / np.maximum(x**2 + y**2 - half**2, 1e-6)
        return math.atan(self._wheelbase * float(curvature.min()))
