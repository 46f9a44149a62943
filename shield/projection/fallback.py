r"""What to send when there is nothing to follow: the last plan, then brakes.

Both are admissible by construction, because both pass the forward repair: from an admissible
command it always has an answer, without a solver and in time O(H).
"""

import numpy as np

from shield.errors import Array
from shield.limits.actuator_limits import ActuatorLimits
from shield.projection.repair import repair

__all__ = ["FallbackPlan", "braking_targets"]


def braking_targets(limits: ActuatorLimits, steering: float, horizon: int) -> list[float]:
    """Return flat targets (2 H,) that brake to the slowest speed and hold the steering.

    Repaired, they brake at the full rate. The steering stays on its arc and is eased only where
    the lateral bound asks for it: straightening the wheels in a bend would leave the lane.
    """
    slowest = min(max(0.0, limits.min_speed), limits.max_speed)
    return [steering, slowest] * horizon


class FallbackPlan:
    """Remembers the last plan; hands out its rest, then braking."""

    def __init__(self, limits: ActuatorLimits) -> None:
        self._limits = limits
        self._rest: list[float] = []

    def reset(self) -> None:
        """Forget the plan."""
        self._rest = []

    def remember(self, commands: Array) -> None:
        """Keep a plan whose first command is being executed now.

        Args:
            commands: Plan [rad, m/s], shape (H, 2); the part from the first value that is not
                finite on is dropped.
        """
        finite = np.logical_and.accumulate(np.isfinite(commands[1:]).all(axis=1))
        self._rest = commands[1:][finite].ravel().tolist()

    def advance(self) -> None:
        """Drop the step that has just been executed."""
        self._rest = self._rest[2:]

    def horizon(self, steering: float, speed: float, length: int) -> tuple[list[float], str]:
        """Return an admissible flat horizon (2 length,) from the last command, and what it is."""
        targets = self._rest[: 2 * length]
        what = "the last plan shifted by one" if targets else "braking"
        missing = length - len(targets) // 2
        last_steering = targets[-2] if targets else steering
        targets += braking_targets(self._limits, last_steering, missing)
        return repair(self._limits, targets, steering, speed).commands, what
