"""Between normalised actions and commands, without the shield's checks, for the sampling loop."""

from __future__ import annotations

from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from shield import ActuatorLimits

Array = NDArray[np.float64]


class ActionScale:
    """The affine map of `ActuatorLimits.to_command` with its numbers at hand.

    What reaches the actuators is never converted here: projections return commands.

    Args:
        limits: Actuators.

    Attributes:
        centre: Command of the action (0, 0), (2,) [rad, m/s].
        half: Command change per unit of action (2,) [rad, m/s].
    """

    def __init__(self, limits: ActuatorLimits) -> None:
        self.centre = 0.5 * (limits.low + limits.high)
        self.half = 0.5 * (limits.high - limits.low)
        self._per_half = np.where(
            self.half > 0.0, 1.0 / np.where(self.half > 0.0, self.half, 1.0), 0.0
        )

    @classmethod
    @cache
    def of(cls, limits: ActuatorLimits) -> Self:
        """The map of these limits, made once: every plan needs it in half a dozen places."""
        return cls(limits)

    def to_command(self, actions: Array) -> Array:
        """Actions (..., 2) to commands [rad, m/s]."""
        return self.centre + self.half * actions

    def to_action(self, commands: Array) -> Array:
        """Commands (..., 2) [rad, m/s] to actions; 0 for a box of width 0."""
        return (commands - self.centre) * self._per_half
