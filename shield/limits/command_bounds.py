"""Bounds of one step alone, which the surroundings set and not the vehicle."""

import math
from dataclasses import dataclass

import numpy as np

from shield.errors import Array, check_numbers

__all__ = ["CommandBounds"]


@dataclass(frozen=True, slots=True)
class CommandBounds:
    """What the next command should keep, as far as the limits of the vehicle let it.

    Values that are not numbers bound like 0: not knowing is a risk.

    Attributes:
        right: Sharpest steering to the right [rad].
        left: Sharpest steering to the left [rad], not below `right`.
        max_speed: [m/s]

    Raises:
        InvalidProblem: A bound is not of a number's type.
    """

    right: float = -math.inf
    left: float = math.inf
    max_speed: float = math.inf

    def __post_init__(self) -> None:
        """Check the types; any value will do."""
        check_numbers(right=self.right, left=self.left, max_speed=self.max_speed)

    def limit(self, command: Array, min_speed: float) -> Array:
        """Return the nearest command (2,) within the bounds, its speed not below `min_speed`."""
        steering, speed = command.tolist()
        steering = max(min(steering, _known(self.left)), _known(self.right))
        return np.array([steering, min(speed, max(_known(self.max_speed), min_speed))])


def _known(bound: float) -> float:
    return 0.0 if math.isnan(bound) else bound
