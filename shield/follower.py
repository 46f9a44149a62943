r"""From a set-point to the next command, the same for every source of set-points.

Steering and speed are each followed by a critically damped second-order filter with limits. With
the error e to the set-point and the change c of the last period,

.. math:: c^+ = \mathrm{sat}\big((1-p)^2 e + p^2 c\big),\qquad p = e^{-\omega\,dt},

where sat bounds the change, by how much it differs from c (acceleration of the steering, jerk of
the car), and the change from which the command still comes to rest at the set-point: b (n + f) for
:math:`e = b\,(n(n+1)/2 + f(n+1))`, n whole and f in [0, 1), if each change is less by b than the
last. So a step is followed without overshoot.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from shield.errors import Array, as_array
from shield.limits.actuator_limits import ActuatorLimits

__all__ = ["SetpointFollower"]

STEERING_FREQUENCY, SPEED_FREQUENCY = 10.0, 5.0  # [rad/s] a ramp is followed 2 / omega late
LATERAL_JERK = 5.0  # [m/s^3] most that UN R79 (5.6.2.1.3) allows a lane-keeping system
STEERING_RISE = 0.2  # [s] in which the steering comes to the rate that this jerk allows
ACCELERATION, DECELERATION = 1.5, 3.0  # [m/s^2] comfortable; ISO 15622 allows 2.0 and 3.5
JERK = 3.0  # [m/s^3] along the road; ISO 22179 allows 5 at city speeds, 2.5 at higher ones
EMERGENCY = 3.0  # [m/s] a set-point that lies further below is braked for with all there is
AT_REST = 0.1  # [m/s] a slower car stands
ARRIVED = 1e-12  # [rad], [m/s] from the set-point, by rounding on either side of it
INSIDE = 1.0 - 1e-9  # of a bound, so that rounding breaks none


class SetpointFollower:
    """Follows set-points within G1-G3 and comfortably; brakes hard where far less speed is asked.

    Its only state is what was executed, so it goes on from where a shield has led: from rest, with
    `before` the same as `previous`, lest it goes on with the shield's turn or braking. From a
    command that keeps G1 and G3 every answer keeps G1-G3.
    """

    def __init__(self, limits: ActuatorLimits) -> None:
        self.limits = limits
        dt = limits.dt
        self._poles = math.exp(-STEERING_FREQUENCY * dt), math.exp(-SPEED_FREQUENCY * dt)
        self._rise = min(ACCELERATION * dt, limits.acceleration_step) * INSIDE
        self._fall = min(DECELERATION * dt, limits.deceleration_step) * INSIDE

    @property
    def lead(self) -> tuple[int, int]:
        """Periods by which ramps of steering and speed are followed late, rounded."""
        steering, speed = (round((1.0 + p) / (1.0 - p)) for p in self._poles)
        return steering, speed

    def follow(self, setpoint: ArrayLike, previous: ArrayLike, before: ArrayLike) -> Array:
        """Return the next command (2,) [rad, m/s].

        Args:
            setpoint: Steering and speed asked for (2,) [rad, m/s], any values; what is not finite
                is returned as it is, for the shield to judge.
            previous: The last executed command (2,) [rad, m/s].
            before: The one before it.

        Raises:
            InvalidProblem: A shape is not (2,).
        """
        target = as_array("setpoint", setpoint, (2,))
        if not np.isfinite(target).all():
            return target.copy()
        limits = self.limits
        steering, speed = as_array("previous", previous, (2,)).tolist()
        last_steering, last_speed = as_array("before", before, (2,)).tolist()
        goal = min(max(float(target[1]), limits.min_speed), limits.max_speed)
        faster = speed + self._speed_change(goal - speed, speed - last_speed)
        faster = min(max(faster, limits.min_speed), limits.max_speed)
        step = limits.steering_step * INSIDE
        if abs(speed) < AT_REST and abs(float(target[0]) - steering) > step:
            faster = min(faster, speed)  # the wheels turn first: a wrong way on may be refused
        if self.sharpest(faster) < abs(steering) - step:
            faster = speed  # holding both is always possible
        sharpest = self.sharpest(faster)
        angle = min(max(float(target[0]), -sharpest), sharpest)
        comfortable = LATERAL_JERK * limits.dt * limits.wheelbase / max(faster**2, 1e-6)
        step, rise = min(step, comfortable), comfortable * limits.dt / STEERING_RISE
        error, turn = angle - steering, steering - last_steering
        turn = advance(error, turn, (step, step), rise, self._poles[0])
        return np.array([min(max(steering + turn, -sharpest), sharpest), faster])

    def approach(
        self, setpoint: ArrayLike, previous: ArrayLike, before: ArrayLike, horizon: int
    ) -> Array:
        """Commands (horizon, 2) [rad, m/s] that follow a set-point which stays where it is."""
        commands = [np.asarray(before), np.asarray(previous)]
        for _ in range(horizon):
            commands.append(self.follow(setpoint, commands[-1], commands[-2]))
        return np.array(commands[2:])

    def sharpest(self, speed: float) -> float:
        """Largest steering angle that G1 and G3 allow at a speed [m/s], [rad]."""
        bound = self.limits.certain_bound * INSIDE
        return min(self.limits.max_steering, math.atan2(bound, speed**2))

    def _speed_change(self, error: float, change: float) -> float:
        limits = self.limits
        hard = change < -self._fall * (1.0 + 1e-6)  # goes on until the set-point is reached
        if error < -EMERGENCY or (hard and error < 0.0):
            return max(error, -limits.deceleration_step * INSIDE)
        bounds = self._fall, self._rise
        return advance(error, change, bounds, JERK * limits.dt**2, self._poles[1])


def advance(
    error: float, change: float, bounds: tuple[float, float], bend: float, pole: float
) -> float:
    """Next change towards what is `error` away, from the last `change`.

    The bounds are how far it may fall and rise, `bend` by how much it may differ from the last.
    """
    fall, rise = bounds
    change = min(max(change, -fall), rise)
    target = (1.0 - pole) ** 2 * error + pole**2 * change
    most = _largest(abs(error), bend)
    if error >= -ARRIVED:
        target = min(target, most)
    if error <= ARRIVED:
        target = max(target, -most)
    return min(max(target, change - bend, -fall), change + bend, rise)


def _largest(distance: float, bend: float) -> float:
    """The largest change that still comes to rest after `distance`, getting less by `bend`."""
    share = distance / bend
    whole = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * share) - 1.0))
    return bend * (whole + (share - 0.5 * whole * (whole + 1)) / (whole + 1))
