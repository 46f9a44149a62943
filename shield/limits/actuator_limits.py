"""What the actuators of a car-like vehicle can follow: box, rates and lateral acceleration."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from shield.errors import Array, InvalidLimits, InvalidProblem, as_array, as_float, check_within
from shield.limits.rounding import BAND, difference_exceeds

__all__ = ["ActuatorLimits"]

# Outside this range a physical quantity is a mistake of units; inside it no product of two or
# three of them overflows or loses digits to underflow, which the exact checks rely on.
_SMALLEST, _LARGEST = 1e-12, 1e12


@dataclass(frozen=True, slots=True)
class ActuatorLimits:
    r"""Bounds on the commands (steering δ [rad], speed v [m/s]) sent every `dt`.

    With the last executed command :math:`u_{t-1}`, a command :math:`u_t = (\delta_t, v_t)` is
    *admissible* when

    * G1 (box): :math:`|\delta_t| \le \delta_{max}` and :math:`v_{min} \le v_t \le v_{max}`;
    * G2 (rate): :math:`|\delta_t - \delta_{t-1}| \le \dot\delta_{max}\,dt` and
      :math:`-b_{max}\,dt \le v_t - v_{t-1} \le a_{max}\,dt`;
    * G3 (lateral): :math:`|v_t^2 \tan\delta_t / L| \le a_{lat,max}`.

    The products rate · dt are those of float64 arithmetic; no comparison errs on the side of a
    violation. Speeds are signed: acceleration bounds how fast `v` rises, deceleration how it falls.

    Attributes:
        dt: Control period [s]. Default: 10 Hz, the rate of the whole project.
        max_steering: Largest steering angle at the wheels [rad], below π/2. Default: 0.5 (28.6°),
            a passenger car.
        max_steering_rate: Largest steering rate [rad/s]. Default: 0.6.
        min_speed: Smallest speed [m/s]; negative allows reversing. Default: 0.
        max_speed: Largest speed [m/s]. Default: 12 (43 km/h), city traffic.
        max_acceleration: Largest rise of the speed [m/s²]. Default: 3, comfortable.
        max_deceleration: Largest fall of the speed [m/s²]. Default: 6, firm braking on dry road.
        max_lateral_acceleration: Bound on v² tan δ / L [m/s²]; None switches it off. Default: 4,
            half of what tyres hold on dry road.
        wheelbase: Distance between the axles L [m]. Default: 2.7.

    Raises:
        InvalidLimits: A value is not a finite number, has the wrong sign, or min exceeds max.
    """

    dt: float = 0.1
    max_steering: float = 0.5
    max_steering_rate: float = 0.6
    min_speed: float = 0.0
    max_speed: float = 12.0
    max_acceleration: float = 3.0
    max_deceleration: float = 6.0
    max_lateral_acceleration: float | None = 4.0
    wheelbase: float = 2.7

    def __post_init__(self) -> None:
        """Refuse impossible values, naming the field and the value received."""
        for name in self.__slots__:
            value = getattr(self, name)
            if name == "max_lateral_acceleration" and value is None:
                continue
            low = -_LARGEST if name in ("min_speed", "max_speed") else _SMALLEST
            check_within(InvalidLimits, low, _LARGEST, **{name: value})
            object.__setattr__(self, name, as_float(value))
        if self.max_steering >= math.pi / 2:
            raise InvalidLimits(f"`max_steering` must be below π/2 rad. Got {self.max_steering!r}.")
        if self.min_speed > self.max_speed:
            raise InvalidLimits(
                "`min_speed` must not exceed `max_speed`. "
                f"Got min_speed={self.min_speed!r}, max_speed={self.max_speed!r}."
            )

    @property
    def steering_step(self) -> float:
        """Largest change of the steering in one period, the float64 product [rad]."""
        return self.max_steering_rate * self.dt

    @property
    def acceleration_step(self) -> float:
        """Largest rise of the speed in one period, the float64 product [m/s]."""
        return self.max_acceleration * self.dt

    @property
    def deceleration_step(self) -> float:
        """Largest fall of the speed in one period, the float64 product [m/s]."""
        return self.max_deceleration * self.dt

    @property
    def low(self) -> Array:
        """Lower corner of the box ([rad], [m/s]), shape (2,), read-only."""
        return _frozen([-self.max_steering, self.min_speed])

    @property
    def high(self) -> Array:
        """Upper corner of the box ([rad], [m/s]), shape (2,), read-only."""
        return _frozen([self.max_steering, self.max_speed])

    @property
    def max_increase(self) -> Array:
        """Largest increase in one period ([rad], [m/s]), shape (2,), read-only."""
        return _frozen([self.steering_step, self.acceleration_step])

    @property
    def max_decrease(self) -> Array:
        """Largest decrease in one period ([rad], [m/s]), shape (2,), read-only."""
        return _frozen([self.steering_step, self.deceleration_step])

    @property
    def step(self) -> Array:
        """Largest change in one period in either direction ([rad], [m/s]), shape (2,)."""
        return _frozen([self.steering_step, max(self.acceleration_step, self.deceleration_step)])

    @property
    def step_weights(self) -> tuple[float, float]:
        """Weights 1 / step² that measure squared distances in steps of the actuators."""
        return 1.0 / self.step[0] ** 2, 1.0 / self.step[1] ** 2

    @property
    def certain_bound(self) -> float:
        """v²·|tan δ| up to which G3 holds whatever the rounding [m²/s²]; infinite without G3."""
        if self.max_lateral_acceleration is None:
            return math.inf
        return self.max_lateral_acceleration * self.wheelbase * (1.0 - BAND)

    def to_command(self, action: ArrayLike) -> Array:
        """Map normalised actions to commands [rad, m/s]; -1 and 1 are the exact ends of the box.

        Args:
            action: Normalised (steering, speed), shape (..., 2). Values outside [-1, 1] map outside
                the box on purpose: clipping is the shield's work, and it says so.

        Raises:
            InvalidProblem: The last axis is not of length 2.
        """
        values = _pairs("action", action)
        with np.errstate(all="ignore"):
            weight = 0.5 * (values + 1.0)
            command = self.low * (1.0 - weight) + self.high * weight
        inside = np.abs(values) <= 1.0
        return np.where(inside, np.clip(command, self.low, self.high), command)

    def to_action(self, command: ArrayLike) -> Array:
        """Map commands (..., 2) [rad, m/s] to normalised actions; 0 for a speed box of width 0.

        It is the inverse of `to_command` up to rounding.

        Raises:
            InvalidProblem: The last axis is not of length 2.
        """
        values = _pairs("command", command)
        low, high = self.low, self.high
        width = high - low
        span = np.where(width > 0.0, width, 1.0)
        with np.errstate(all="ignore"):
            action = np.where(width > 0.0, ((values - low) - (high - values)) / span, 0.0)
        inside = (low <= values) & (values <= high)
        return np.where(inside, np.clip(action, -1.0, 1.0), action)

    def lateral_acceleration(self, command: ArrayLike) -> Array:
        """Return the signed v² tan δ / L [m/s²] of commands of shape (..., 2), shape (...)."""
        values = _pairs("command", command)
        steering, speed = values[..., 0], values[..., 1]
        with np.errstate(all="ignore"):
            return np.asarray(speed * speed * np.tan(steering) / self.wheelbase)

    def violated(self, command: ArrayLike, previous: ArrayLike) -> bool:
        """Tell whether a command breaks G1, G2 or G3, without any tolerance.

        Args:
            command: Executed command [rad, m/s], shape (2,).
            previous: The command executed one period before [rad, m/s], shape (2,).

        Returns:
            True when a bound is broken by any amount, or when a value is not finite. A lateral
            acceleration within 16 ulp below its bound, where float64 cannot tell, counts as broken.

        Raises:
            InvalidProblem: A shape is not (2,).
        """
        steering, speed = as_array("command", command, (2,)).tolist()
        last_steering, last_speed = as_array("previous", previous, (2,)).tolist()
        if not (abs(steering) <= self.max_steering and self.min_speed <= speed <= self.max_speed):
            return True
        if not (math.isfinite(last_steering) and math.isfinite(last_speed)):
            return True
        if (
            difference_exceeds(steering, last_steering, self.steering_step)
            or difference_exceeds(last_steering, steering, self.steering_step)
            or difference_exceeds(speed, last_speed, self.acceleration_step)
            or difference_exceeds(last_speed, speed, self.deceleration_step)
        ):
            return True
        return bool(speed * speed * abs(math.tan(steering)) > self.certain_bound)

    def is_admissible(self, command: ArrayLike) -> bool:
        """Tell whether a command (2,) satisfies G1 and G3, whatever came before it."""
        return not self.violated(command, command)


def _frozen(values: list[float]) -> Array:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def _pairs(name: str, values: ArrayLike) -> Array:
    array = as_array(name, values)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise InvalidProblem(f"`{name}` must have shape (..., 2). Got {array.shape}.")
    return array
