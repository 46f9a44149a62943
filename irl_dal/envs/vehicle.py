"""The ego car: four wheels under Bullet's physics, or a kinematic bicycle for quick tests.

A low-level controller turns a command [steering, speed] into hinge and wheel motors.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from irl_dal.envs.world import World
from shield import ActuatorLimits, VehicleGeometry

WHEELBASE = ActuatorLimits().wheelbase
"""[m], where no other is asked for."""

GEOMETRY = VehicleGeometry()
"""Outline of the car, where no other is asked for."""

TRACK, WHEEL_RADIUS = 1.6, 0.33
"""Of the body in `car.urdf` [m]."""

BASE_HEIGHT = 0.45
"""Of the centre of mass above the ground [m], in `car.urdf`."""

MASS = 1500.0
"""With the wheels [kg]."""

DRIVE_ACCELERATION = 6.0
BRAKE_DECELERATION = 8.0
"""What the wheel motors can do [m/s^2]: above the shield's bounds, below the tyres' grip."""

SERVO_RATE = 1.2
"""Turning rate of the steering hinges [rad/s]."""

SERVO_TORQUE = 4000.0
"""[N m]"""

GRIP = 1.0
"""Coulomb friction coefficient of the tyres."""


@dataclass(frozen=True, slots=True)
class VehicleState:
    """True state of the car at the middle of its rear axle.

    Attributes:
        x: Position [m].
        y: Position [m].
        yaw: Heading [rad], positive to the left.
        speed: Forward speed [m/s].
        yaw_rate: [rad/s].
        lateral_speed: Sideways speed at the rear axle [m/s]: the slip.
    """

    x: float
    y: float
    yaw: float
    speed: float
    yaw_rate: float
    lateral_speed: float


class Vehicle:
    """The car in the world.

    Args:
        world: Physics in which it drives.
        wheelbase: Distance between the axles [m].
        servo_rate: Turning rate of the steering hinges [rad/s].
        geometry: Outline of the body.

    Raises:
        ValueError: The front axle would lie before the bumper.
    """

    def __init__(
        self,
        world: World,
        wheelbase: float = WHEELBASE,
        servo_rate: float = SERVO_RATE,
        geometry: VehicleGeometry = GEOMETRY,
    ) -> None:
        if wheelbase >= geometry.front_bumper:
            raise ValueError(
                f"`wheelbase` must be below {geometry.front_bumper} m, where the front bumper is. "
                f"Got {wheelbase}."
            )
        self._world = world
        self._wheelbase = wheelbase
        # Halfway between the axles, where Bullet keeps the base frame [m].
        self._centre = 0.5 * wheelbase
        self._servo_rate = servo_rate
        self._speed = 0.0
        self.body = world.car(
            wheelbase=wheelbase,
            centre_of_mass=self._centre,
            middle=geometry.front_bumper - 0.5 * geometry.length,
            length=geometry.length,
            width=geometry.width,
        )
        joints = world.joints(self.body)
        self._steer = [joints["front_left_steer"], joints["front_right_steer"]]
        self._spin = [
            joints[f"{end}_{side}_spin"] for end in ("front", "rear") for side in ("left", "right")
        ]
        for link in self._spin:
            world.friction(self.body, link, GRIP)

    def place(self, x: float, y: float, yaw: float, speed: float) -> None:
        """Put the car's rear axle at (x, y) [m] with heading `yaw` [rad], rolling at `speed`."""
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        at = np.array([x, y]) + self._centre * ahead
        self._world.move(self.body, (float(at[0]), float(at[1]), BASE_HEIGHT), yaw)
        self._world.set_velocity(self.body, (*(speed * ahead).tolist(), 0.0))
        for joint in self._steer:
            self._world.set_joint(self.body, joint, 0.0, 0.0)
        for joint in self._spin:
            self._world.set_joint(self.body, joint, 0.0, speed / WHEEL_RADIUS)
        self._speed = speed
        self.drive(0.0, speed)

    def drive(self, steering: float, speed: float) -> None:
        """Set the motors for a command until the next one.

        The bicycle's steering angle becomes the two angles of an Ackermann axle and each wheel
        gets the speed of its own circle, so that no tyre has to scrub.

        Args:
            steering: Angle of the bicycle's front wheel [rad].
            speed: Speed of the rear axle's middle [m/s].
        """
        wheelbase = self._wheelbase
        curvature = float(np.tan(steering)) / wheelbase
        half = 0.5 * TRACK
        for joint, y in zip(self._steer, (half, -half), strict=True):
            angle = float(np.arctan2(wheelbase * curvature, 1.0 - y * curvature))
            self._world.hinge(self.body, joint, angle, self._servo_rate, SERVO_TORQUE)
        faster = speed > self._speed
        pull = DRIVE_ACCELERATION if faster else BRAKE_DECELERATION
        torque = 0.25 * MASS * pull * WHEEL_RADIUS
        wheels = ((wheelbase, half), (wheelbase, -half), (0.0, half), (0.0, -half))
        for joint, (x, y) in zip(self._spin, wheels, strict=True):
            own = speed * float(np.hypot(1.0 - y * curvature, x * curvature))
            self._world.spin(self.body, joint, own / WHEEL_RADIUS, torque)

    def advance(self, duration: float) -> None:
        """Let the world go on for `duration` [s]."""
        self._world.step(duration)

    def touches(self, others: Iterable[int]) -> bool:
        """Whether the car touches anything but the ground."""
        del others  # the engine knows
        return bool(self._world.touching(self.body))

    def steering(self) -> float:
        """Angle of the bicycle's front wheel as the hinges stand [rad]."""
        left, right = (self._world.joint_angle(self.body, joint) for joint in self._steer)
        return float(np.arctan(0.5 * (np.tan(left) + np.tan(right))))

    def state(self) -> VehicleState:
        """Where the car is and how it moves."""
        position, rotation = self._world.frame(self.body)
        linear, angular = self._world.velocity(self.body)
        yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        rear = position[:2] - self._centre * ahead
        self._speed = float(ahead @ linear[:2])
        sideways = float(-ahead[1] * linear[0] + ahead[0] * linear[1])
        return VehicleState(
            x=float(rear[0]),
            y=float(rear[1]),
            yaw=yaw,
            speed=self._speed,
            yaw_rate=float(angular[2]),
            lateral_speed=sideways - self._centre * float(angular[2]),
        )


class KinematicVehicle(Vehicle):
    """A bicycle that does exactly what it is told: `env.dynamics=kinematic`.

    It has the car's looks but no mass: it moves on circles of the commanded steering at the
    commanded speed.

    Args:
        world: World in which it is seen.
        wheelbase: Distance between the axles [m].
        servo_rate: Turning rate of the steering [rad/s].
    """

    STEPS = 10
    """Integration steps in one call of `advance`."""

    def __init__(
        self,
        world: World,
        wheelbase: float = WHEELBASE,
        servo_rate: float = SERVO_RATE,
        geometry: VehicleGeometry = GEOMETRY,
    ) -> None:
        super().__init__(world, wheelbase, servo_rate, geometry)
        self._state = VehicleState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._angle = 0.0
        self._target = 0.0

    def place(self, x: float, y: float, yaw: float, speed: float) -> None:
        """Put the car's rear axle at (x, y) [m] with heading `yaw` [rad], rolling at `speed`."""
        self._state = VehicleState(x, y, yaw, speed, 0.0, 0.0)
        self._angle = self._target = 0.0
        self._show()

    def drive(self, steering: float, speed: float) -> None:
        """Take a command [rad, m/s]; the speed is there at once."""
        self._target = steering
        self._state = replace(self._state, speed=speed)

    def advance(self, duration: float) -> None:
        """Integrate the bicycle for `duration` [s]."""
        dt = duration / self.STEPS
        now = self._state
        x, y, yaw, rate = now.x, now.y, now.yaw, 0.0
        for _ in range(self.STEPS):
            change = self._servo_rate * dt
            self._angle += float(np.clip(self._target - self._angle, -change, change))
            rate = now.speed * float(np.tan(self._angle)) / self._wheelbase
            middle = yaw + 0.5 * rate * dt
            x += now.speed * dt * float(np.cos(middle))
            y += now.speed * dt * float(np.sin(middle))
            yaw += rate * dt
        self._state = VehicleState(x, y, yaw, now.speed, rate, 0.0)
        self._show()

    def touches(self, others: Iterable[int]) -> bool:
        """Whether the car's body overlaps one of the bodies `others`."""
        return any(self._world.overlaps(self.body, other) for other in others)

    def steering(self) -> float:
        """Angle of the bicycle's front wheel [rad]."""
        return self._angle

    def state(self) -> VehicleState:
        """Where the car is and how it moves."""
        return self._state

    def _show(self) -> None:
        now = self._state
        ahead = self._centre * np.array([np.cos(now.yaw), np.sin(now.yaw)])
        at = (now.x + float(ahead[0]), now.y + float(ahead[1]), BASE_HEIGHT)
        self._world.move(self.body, at, now.yaw)
