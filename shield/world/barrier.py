"""Both barriers behind one scanner: what the shield asks before every command."""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.arguments import check_positive
from shield.errors import InvalidLimits
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.command_bounds import CommandBounds
from shield.world.flanks import FlankBarrier, FlankConfig
from shield.world.stopping import StoppingBarrier, StoppingConfig
from shield.world.surroundings import Surroundings

__all__ = ["BarrierConfig", "ObstacleBarrier"]

_CHOICES = 21
"""Steering angles that are tried for a way out."""

_RELUCTANCE = 0.3
"""By which steering to the side on which one does not overtake counts as farther away [rad]."""


@dataclass(frozen=True, slots=True)
class BarrierConfig:
    """Where the scanner is, and the numbers of the barriers.

    Attributes:
        enabled: Whether the shield has barriers.
        forward: From the rear axle to the scanner in the front bumper [m].
        max_range: Reading of a beam that hit nothing [m].
        escape_speed: At which a car that has been stopped steers free of what it stands before, if
            any steering is free [m/s].
        patience: How long it stands before it does so [s]; who walks has gone by then.
        overtaking: Side on which it then rather goes, `left` or `right`: on the other one the road
            may end.
        stopping: Of the speed.
        flanks: Of the steering.

    Raises:
        InvalidLimits: A number is not positive and finite, or a side that is none.
    """

    enabled: bool = True
    forward: float = 3.6
    max_range: float = 40.0
    escape_speed: float = 1.0
    patience: float = 4.0
    overtaking: Literal["left", "right"] = "left"
    stopping: StoppingConfig = field(default_factory=StoppingConfig)
    flanks: FlankConfig = field(default_factory=FlankConfig)

    def __post_init__(self) -> None:
        """Refuse what cannot be, naming the field and the value received."""
        check_positive(
            InvalidLimits,
            forward=self.forward,
            max_range=self.max_range,
            escape_speed=self.escape_speed,
            patience=self.patience,
        )
        if self.overtaking not in ("left", "right"):
            raise InvalidLimits(f"`overtaking` must be left or right. Got {self.overtaking!r}.")


class ObstacleBarrier:
    """Bounds the next command by what a scanner sees and has seen.

    Args:
        config: Scanner and barriers.
        limits: Limits of the vehicle.

    Attributes:
        surroundings: What is there.
    """

    def __init__(self, config: BarrierConfig, limits: ActuatorLimits) -> None:
        self._config = config
        self._limits = limits
        braking = min(config.stopping.braking, limits.max_deceleration)
        stopping = replace(config.stopping, braking=braking)
        self._stopping = StoppingBarrier(stopping, limits.wheelbase)
        self._flanks = FlankBarrier(config.flanks, limits.wheelbase)
        self.surroundings = Surroundings(
            limits.dt,
            forward=config.forward,
            max_range=config.max_range,
            reach=config.stopping.horizon,
        )
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self.surroundings.reset()
        self._blocked = 0

    def update(self, scan: ArrayLike, speed: float, yaw_rate: float) -> None:
        """Take a scan, as `Surroundings.update` does."""
        self.surroundings.update(scan, speed, yaw_rate)

    def bounds(self, command: NDArray[np.float64], previous: float) -> CommandBounds:
        """Bounds of the next command.

        Args:
            command: Wanted (2,) [rad, m/s]; a steering that is not a number counts as the last one.
            previous: Last executed steering [rad].
        """
        steering, wanted = command.tolist()
        steering = previous if math.isnan(steering) else steering
        right, left = self._flanks.steering(self.surroundings)
        speed = self._max_speed(min(max(steering, right), left), previous)
        if self._stands(speed, wanted):
            way_out = self._way_out(steering, right, left)
            if way_out is not None:
                right = left = way_out
                speed = min(self._max_speed(way_out, previous), self._config.escape_speed)
        return CommandBounds(right, left, speed)

    def _stands(self, speed: float, wanted: float) -> bool:
        """Whether the car has stood long enough before something that it wants to pass."""
        creep = self._config.escape_speed
        blocked = speed < min(creep, wanted) and self.surroundings.speed < 1.5 * creep
        self._blocked = self._blocked + 1 if blocked else 0
        return self._blocked * self._limits.dt > self._config.patience

    def _max_speed(self, steering: float, previous: float) -> float:
        """Bound of the speed on the arc of the steering that this step can reach [m/s]."""
        step = self._limits.steering_step
        reachable = min(max(steering, previous - step), previous + step)
        return self._stopping.max_speed(self.surroundings, reachable)

    def _way_out(self, steering: float, right: float, left: float) -> float | None:
        """The steering nearest to the wanted one on whose arc the car can creep on, if any."""
        lock = self._limits.max_steering
        choices = np.linspace(max(right, -lock), min(left, lock), _CHOICES)
        side = 1.0 if self._config.overtaking == "left" else -1.0
        for choice in sorted(
            choices.tolist(),
            key=lambda angle: abs(angle - steering) + _RELUCTANCE * (side * angle < 0.0),
        ):
            if self._stopping.max_speed(self.surroundings, choice) >= self._config.escape_speed:
                return float(choice)
        return None
