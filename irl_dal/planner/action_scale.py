"""Between normalised actions and commands, without the shield's checks, for the sampling loop."""

import numpy as np

from irl_dal.arrays import Array
from shield import ActuatorLimits


class ActionScale:
    """The affine map of `ActuatorLimits.to_command` with its numbers at hand.

    What reaches the actuators is never converted here: projections return commands.
    """

    def __init__(self, limits: ActuatorLimits) -> None:
        self.centre = 0.5 * (limits.low + limits.high)  # Of the action (0, 0) (2,) [rad, m/s]
        self.half = 0.5 * (limits.high - limits.low)  # Per unit of action (2,) [rad, m/s]
        self._per_half = np.divide(1.0, self.half, out=np.zeros(2), where=self.half > 0.0)

    def to_command(self, actions: Array) -> Array:
        """Actions (..., 2) to commands [rad, m/s]."""
        return self.centre + self.half * actions

    def to_action(self, commands: Array) -> Array:
        """Commands (..., 2) [rad, m/s] to actions; 0 for a box of width 0."""
        return (commands - self.centre) * self._per_half
