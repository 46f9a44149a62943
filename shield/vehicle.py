r"""The car's outline, and the kinematic bicycle, written once in CasADi.

Position of the rear axle x (forward), y [m]; heading ψ (`yaw`) [rad], positive to the left; angle
of the front wheel δ (`steering`) [rad], left positive; speed of the rear axle v [m/s]; distance
between the axles L (`wheelbase`) [m].

.. math:: \dot x = v\cos\psi,\quad \dot y = v\sin\psi,\quad \dot\psi = v\tan\delta / L

The lateral acceleration of the rear axle is :math:`v\dot\psi = v^2\tan\delta/L`.
"""

import math
from dataclasses import asdict, dataclass

import casadi
import numpy as np
from numpy.typing import ArrayLike

from shield.errors import Array, InvalidLimits, as_array, as_horizon, check_positive

__all__ = ["KinematicBicycle", "VehicleGeometry", "carried", "yaw_rate_between"]


@dataclass(frozen=True, slots=True)
class VehicleGeometry:
    """Outline of the car; its wheelbase is `ActuatorLimits.wheelbase`.

    Attributes:
        length: From bumper to bumper [m].
        width: Of the body [m].
        front_bumper: From the rear axle to the front bumper [m].

    Raises:
        InvalidLimits: A length is not positive and finite, or the rear axle lies outside the body.
    """

    length: float = 4.5
    width: float = 1.8
    front_bumper: float = 3.6

    def __post_init__(self) -> None:
        """Check every field."""
        check_positive(InvalidLimits, **asdict(self))
        if self.front_bumper >= self.length:
            raise InvalidLimits(f"`front_bumper` must be below `length`. Got {self!r}.")

    @property
    def rear_overhang(self) -> float:
        """From the rear axle back to the rear bumper [m]."""
        return self.length - self.front_bumper


def yaw_rate_between(before: float, steering: float, speed: float, wheelbase: float) -> float:
    """Mean yaw rate [rad/s] of a period in which the wheels turn from `before` to `steering` [rad].

    The wheels take about a period to follow: in the physics, with the angle's mean, it errs by
    0.006 rad/s (RMS), with the new angle by 0.03 rad/s.

    Args:
        before: Steering that was in force until the period began [rad].
        steering: Steering commanded for the period [rad].
        speed: Speed of the rear axle [m/s].
        wheelbase: Distance between the axles [m].
    """
    return speed * math.tan(0.5 * (before + steering)) / wheelbase


def carried(points: Array, speed: float, yaw_rate: float, dt: float) -> Array:
    """Where points (n, 2) [m] that stand are for the car after a period `dt` [s] of its motion.

    The frame is that of the rear axle. Directions turn with it: they are carried at `speed` 0.

    Args:
        points: Places in the frame of before.
        speed: Of the rear axle [m/s].
        yaw_rate: Of the car [rad/s].
        dt: Length of the period [s].
    """
    turn, way = yaw_rate * dt, speed * dt
    cos, sin = math.cos(turn), math.sin(turn)
    driven = np.array([way * math.cos(0.5 * turn), way * math.sin(0.5 * turn)])
    return np.asarray((points - driven) @ np.array([[cos, -sin], [sin, cos]]))


class KinematicBicycle:
    """CasADi functions of the kinematic bicycle, with numpy-facing helpers.

    Args:
        wheelbase: Distance between the axles L [m].
        dt: Control period during which a command is held [s].

    Attributes:
        dynamics: ``(state (3,), command (2,)) -> derivative (3,)``, a `casadi.Function`.
        step: ``(state (3,), command (2,)) -> next state (3,)``, one RK4 step of `dt`.
        lateral_acceleration: ``command (2,) -> v² tan δ / L`` [m/s²].

    Raises:
        InvalidLimits: `wheelbase` or `dt` is not positive and finite.
    """

    def __init__(self, wheelbase: float, dt: float) -> None:
        check_positive(InvalidLimits, wheelbase=wheelbase, dt=dt)
        self.wheelbase, self.dt = float(wheelbase), float(dt)
        state, command = casadi.SX.sym("state", 3), casadi.SX.sym("command", 2)
        yaw, steering, speed = state[2], command[0], command[1]
        yaw_rate = speed * casadi.tan(steering) / self.wheelbase
        derivative = casadi.vertcat(speed * casadi.cos(yaw), speed * casadi.sin(yaw), yaw_rate)
        self.dynamics = casadi.Function("dynamics", [state, command], [derivative])
        # One classical Runge-Kutta step; exact in ψ, fourth order in x and y.
        k1 = self.dynamics(state, command)
        k2 = self.dynamics(state + 0.5 * self.dt * k1, command)
        k3 = self.dynamics(state + 0.5 * self.dt * k2, command)
        k4 = self.dynamics(state + self.dt * k3, command)
        after = state + self.dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        self.step = casadi.Function("step", [state, command], [after])
        lateral = [speed * yaw_rate]
        self.lateral_acceleration = casadi.Function("lateral_acceleration", [command], lateral)

    def rollout(self, state: ArrayLike, commands: ArrayLike) -> Array:
        """Return the states (H, 3) after each command.

        Args:
            state: Initial (x, y, ψ) [m, m, rad], shape (3,).
            commands: Commands [rad, m/s], shape (H, 2).

        Raises:
            InvalidProblem: A shape or a type does not fit.
        """
        pose = as_array("state", state, (3,))
        actions = as_horizon("commands", commands)
        states = self.step.mapaccum(actions.shape[0])(pose, actions.T)
        return np.array(states.full().T)
