"""The ego car: four wheels under Bullet's physics.

A low-level controller turns a command [steering, speed] into hinge and wheel motors.
"""

from dataclasses import dataclass

import numpy as np

from irl_dal.envs.world import World
from shield import ActuatorLimits, VehicleGeometry

WHEELBASE = ActuatorLimits().wheelbase  # [m], where no other is asked for
GEOMETRY = VehicleGeometry()  # Outline of the car, where no other is asked for
TRACK, WHEEL_RADIUS = 1.6, 0.33  # Of the body in `car.urdf` [m]
BASE_HEIGHT = 0.45  # Of the centre of mass above the ground [m], in `car.urdf`
MASS = 1500.0  # With the wheels [kg]
# What the wheel motors can do [m/s^2]: above the shield's bounds, below the tyres' grip
DRIVE_ACCELERATION, BRAKE_DECELERATION = 6.0, 8.0
SERVO_RATE = 1.2  # Turning rate of the steering hinges [rad/s]
SERVO_TORQUE, SERVO_GAIN = 4000.0, 0.25  # [N m]; share of the error that a physics step removes
GROUND = 0  # Bullet's number of the first body, which `World.clear` makes
GRIP = 1.0  # Coulomb friction coefficient of the tyres


@dataclass(frozen=True, slots=True)
class VehicleState:
    """True state of the car at the middle of its rear axle."""

    x: float  # Position [m]
    y: float  # Position [m]
    yaw: float  # Heading [rad], positive to the left
    speed: float  # Forward speed [m/s]
    yaw_rate: float  # [rad/s]
    lateral_speed: float  # Sideways speed at the rear axle [m/s]: the slip


class Vehicle:
    """The car in the world; `servo_rate` is the turning rate of its steering hinges [rad/s].

    `ValueError` if the front axle would lie before the bumper.
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
        self._world, self._bullet = world, world.bullet
        self._wheelbase, self._servo_rate, self._speed = wheelbase, servo_rate, 0.0
        self._centre = 0.5 * wheelbase  # Between the axles, where Bullet keeps the base frame [m]
        self.body = world.car(
            wheelbase=wheelbase,
            centre_of_mass=self._centre,
            middle=geometry.front_bumper - 0.5 * geometry.length,
            length=geometry.length,
            width=geometry.width,
        )
        bullet = self._bullet
        rows = [bullet.getJointInfo(self.body, j) for j in range(bullet.getNumJoints(self.body))]
        joints = {row[1].decode(): int(row[0]) for row in rows}
        self._steer = [joints["front_left_steer"], joints["front_right_steer"]]
        wheels = ("front_left", "front_right", "rear_left", "rear_right")
        self._spin = [joints[f"{wheel}_spin"] for wheel in wheels]
        for link in self._spin:
            bullet.changeDynamics(self.body, link, lateralFriction=GRIP)

    def place(self, x: float, y: float, yaw: float, speed: float) -> None:
        """Put the car's rear axle at (x, y) [m] with heading `yaw` [rad], rolling at `speed`."""
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        at = np.array([x, y]) + self._centre * ahead
        self._world.move(self.body, (float(at[0]), float(at[1]), BASE_HEIGHT), yaw)
        velocity = (*(speed * ahead).tolist(), 0.0)
        self._bullet.resetBaseVelocity(self.body, velocity, [0.0, 0.0, 0.0])
        for joint in self._steer:
            self._bullet.resetJointState(self.body, joint, 0.0, 0.0)
        for joint in self._spin:
            self._bullet.resetJointState(self.body, joint, 0.0, speed / WHEEL_RADIUS)
        self._speed = speed
        self.drive(0.0, speed)

    def drive(self, steering: float, speed: float) -> None:
        """Set the motors for a command [rad, m/s] of the bicycle until the next one.

        Its steering angle becomes the two angles of an Ackermann axle and each wheel gets the
        speed of its own circle, so that no tyre has to scrub.
        """
        wheelbase, bullet = self._wheelbase, self._bullet
        curvature = float(np.tan(steering)) / wheelbase
        half = 0.5 * TRACK
        for joint, y in zip(self._steer, (half, -half), strict=True):
            angle = float(np.arctan2(wheelbase * curvature, 1.0 - y * curvature))
            bullet.setJointMotorControl2(
                self.body,
                joint,
                bullet.POSITION_CONTROL,
                targetPosition=angle,
                maxVelocity=self._servo_rate,
                force=SERVO_TORQUE,
                positionGain=SERVO_GAIN,
                velocityGain=1.0,
            )
        pull = DRIVE_ACCELERATION if speed > self._speed else BRAKE_DECELERATION
        torque = 0.25 * MASS * pull * WHEEL_RADIUS
        wheels = ((wheelbase, half), (wheelbase, -half), (0.0, half), (0.0, -half))
        for joint, (x, y) in zip(self._spin, wheels, strict=True):
            own = speed * float(np.hypot(1.0 - y * curvature, x * curvature))
            control = {"targetVelocity": own / WHEEL_RADIUS, "force": torque}
            bullet.setJointMotorControl2(self.body, joint, bullet.VELOCITY_CONTROL, **control)

    def touched(self) -> set[int]:
        """Bullet's numbers of what the car touches, but for the ground."""
        contacts = self._bullet.getContactPoints(bodyA=self.body)
        return {int(row[2]) for row in contacts} - {GROUND, self.body}

    def state(self) -> VehicleState:
        """Where the car is and how it moves."""
        position, quaternion = self._bullet.getBasePositionAndOrientation(self.body)
        rotation = self._bullet.getMatrixFromQuaternion(quaternion)  # (9,), row by row
        linear, angular = self._bullet.getBaseVelocity(self.body)
        yaw = float(np.arctan2(rotation[3], rotation[0]))
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        rear = np.array(position[:2]) - self._centre * ahead
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
