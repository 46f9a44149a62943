"""The way around what blocks a driver who asks to go on: certified, at walking pace.

Of all steering angles the one is taken on whose arc the car gets furthest. The wheels turn while
the car stands, then it creeps; the driver's commands are taken again once their way is free.
"""

import numpy as np

from shield.errors import Array
from shield.limits.actuator_limits import ActuatorLimits
from shield.predictive.certification import Certification

__all__ = ["Detour"]

CREEP = 1.0  # [m/s] walking pace
PATIENCE = 1.0  # [s] for which a blocked car stands first: people have passed by then
REACH, FREE = 6.0, 4.0  # [m] how far the arcs go, and from where on the way counts as free
SHORTEST = 0.5  # [m] no detour is worth less
ANGLES = 21  # that are tried
PREFERENCE = 1.0  # [m/rad] by which an arc far from the driver's has to be longer


class Detour:
    """Notices that a driver is blocked, and finds the way around."""

    def __init__(self, limits: ActuatorLimits) -> None:
        self._limits = limits
        self._angles: Array = np.linspace(-limits.max_steering, limits.max_steering, ANGLES)
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._blocked = 0
        self._steering: float | None = None

    @property
    def active(self) -> bool:
        """Whether the car is on a detour."""
        return self._steering is not None

    def suggest(
        self, checks: Certification, going: Array, previous: Array, speed: float
    ) -> Array | None:
        """The command (2,) [rad, m/s] to try in place of the nominal one; None if not blocked.

        `going` is where the driver is about to go (2,) [rad, m/s], once the wheels have turned.
        """
        limit = min(float(going[1]), CREEP)
        if limit <= 0.0 or speed > 1.5 * CREEP:
            self.reset()
            return None
        if speed > 0.5 * CREEP:
            straight = np.array([going[0]])
            way = checks.free_arcs(straight, self._limits.wheelbase, REACH)[0]
            if self._steering is None or way >= FREE:
                self.reset()
                return None
        self._blocked += 1
        if self._blocked * self._limits.dt < PATIENCE:
            return None
        free = checks.free_arcs(self._angles, self._limits.wheelbase, REACH)
        last = going[0] if self._steering is None else self._steering
        best = int((free - PREFERENCE * np.abs(self._angles - last)).argmax())
        if free[best] < SHORTEST:
            self._steering = None
            return None
        self._steering = float(self._angles[best])
        away = abs(self._steering - float(previous[0]))
        return np.array([self._steering, limit if away < 2.0 * self._limits.steering_step else 0.0])
