"""Both barriers behind one scanner: they bound every command before it is projected."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from shield.errors import InvalidLimits, as_array, check_numbers, check_positive
from shield.estimation.scan import DEFAULT_SCANNER, ScannerGeometry
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.command_bounds import CommandBounds
from shield.vehicle import VehicleGeometry
from shield.world.flanks import FlankBarrier
from shield.world.stopping import HORIZON, StoppingBarrier
from shield.world.surroundings import Surroundings

__all__ = ["ESCAPE_SPEED", "BarrierConfig", "ObstacleBarrier"]

ESCAPE_SPEED = 1.0  # [m/s] at which a blocked car steers free of the obstacle before it
CANDIDATES = 21  # steering angles that are tried for a way around the obstacle
WRONG_SIDE_PENALTY = 0.3  # [rad] by which steering to the wrong side counts as farther away
DEFAULT_VEHICLE = VehicleGeometry()


@dataclass(frozen=True, slots=True)
class BarrierConfig:
    """Numbers of the barriers, none of them in the paper.

    Attributes:
        enabled: Whether the shield has barriers.
        braking: Deceleration that the car counts on [m/s²], at most the limit's: the last resort
            of a driver who should have braked before.
        delay: Time until the brakes hold [s].
        standoff: Distance from the scanner at which the car stands before an obstacle [m]; from
            nearer than 2.5 m it cannot steer free.
        standstill_time: How long a blocked car stands before it steers free of the obstacle, if any
            steering is free [s]; pedestrians have passed by then.
        overtaking: Side to which it then rather steers, `left` or `right`: on the other side the
            road may end.

    Raises:
        InvalidLimits: A number is not positive and finite, or `overtaking` is no side.
    """

    enabled: bool = True
    braking: float = 6.0
    delay: float = 0.2
    standoff: float = 3.0
    standstill_time: float = 4.0
    overtaking: Literal["left", "right"] = "left"

    def __post_init__(self) -> None:
        """Check every field."""
        for name in ("braking", "delay", "standoff", "standstill_time"):
            check_positive(InvalidLimits, **{name: getattr(self, name)})
        if self.overtaking not in ("left", "right"):
            raise InvalidLimits(f"`overtaking` must be left or right. Got {self.overtaking!r}.")


class ObstacleBarrier:
    """Bounds the next command by what a scanner sees and has seen.

    Before the first scan nothing is known, and the car has to stand.

    Args:
        config: Numbers of the barriers.
        limits: Limits of the vehicle.
        scanner: Where the scanner is and where its beams point.
        vehicle: Outline of the car.
    """

    def __init__(
        self,
        config: BarrierConfig,
        limits: ActuatorLimits,
        scanner: ScannerGeometry = DEFAULT_SCANNER,
        vehicle: VehicleGeometry = DEFAULT_VEHICLE,
    ) -> None:
        self._config, self._limits = config, limits
        braking = min(config.braking, limits.max_deceleration)
        self._stopping = StoppingBarrier(
            vehicle, limits.wheelbase, braking, config.delay, config.standoff
        )
        self._flanks = FlankBarrier(vehicle, limits.wheelbase)
        self.surroundings = Surroundings(limits.dt, scanner, HORIZON)
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self.surroundings.reset()
        self._blocked = 0

    def update(self, scan: ArrayLike, speed: float, yaw_rate: float) -> None:
        """Take a scan, as `Surroundings.update` does."""
        self.surroundings.update(scan, speed, yaw_rate)

    def bounds(self, command: ArrayLike, previous: float) -> CommandBounds:
        """Return the bounds of the next command.

        Args:
            command: Nominal command (2,) [rad, m/s]; a steering of NaN counts as the last one.
            previous: Last executed steering [rad]; 0 if not finite.

        Raises:
            InvalidProblem: `command` is not two numbers, or `previous` is not a number.
        """
        steering, nominal_speed = as_array("command", command, (2,)).tolist()
        check_numbers(previous=previous)
        previous = float(previous) if math.isfinite(previous) else 0.0
        steering = previous if math.isnan(steering) else steering
        right, left = self._flanks.steering(self.surroundings)
        speed = self._max_speed(min(max(steering, right), left), previous)
        if self._is_stuck(speed, nominal_speed):
            escape = self._escape(steering, right, left)
            if escape is not None:
                right = left = escape
                speed = min(self._max_speed(escape, previous), ESCAPE_SPEED)
        return CommandBounds(right, left, speed)

    def _is_stuck(self, speed: float, nominal_speed: float) -> bool:
        """Whether the car has stood long enough before an obstacle that it should pass."""
        blocked = speed < min(ESCAPE_SPEED, nominal_speed)
        blocked = blocked and self.surroundings.speed < 1.5 * ESCAPE_SPEED
        self._blocked = self._blocked + 1 if blocked else 0
        return self._blocked * self._limits.dt > self._config.standstill_time

    def _max_speed(self, steering: float, previous: float) -> float:
        """Bound of the speed on the arc of the steering that this step can reach [m/s]."""
        step = self._limits.steering_step
        reachable = min(max(steering, previous - step), previous + step)
        return self._stopping.max_speed(self.surroundings, reachable)

    def _escape(self, steering: float, right: float, left: float) -> float | None:
        """The steering nearest to the nominal one on whose arc the car can creep on, if any."""
        lock = self._limits.max_steering
        candidates = np.linspace(max(right, -lock), min(left, lock), CANDIDATES)
        side = 1.0 if self._config.overtaking == "left" else -1.0
        farness = np.abs(candidates - steering) + WRONG_SIDE_PENALTY * (side * candidates < 0.0)
        for candidate in candidates[np.argsort(farness, kind="stable")].tolist():
            if self._stopping.max_speed(self.surroundings, candidate) >= ESCAPE_SPEED:
                return float(candidate)
        return None
