"""Steering: a cascade of offset, heading and curvature."""

import math
from dataclasses import dataclass

from shield import ActuatorLimits, LaneEstimate
from shield.errors import check_positive

PREVIEW_TIME = 0.15  # [s] look-ahead of the curvature feed-forward
MIN_SPEED = 3.5  # [m/s] below which the offset's gain stops growing
MIN_TURN_SPEED = 2.0  # [m/s] the same of the heading's gain: the inner loop is the faster one
MIN_RATE_SPEED = 1.0  # [m/s] below which a moving target asks for no larger angle
MIN_CONTRACTION = 0.4  # of the distance to the centre of a bend; bounds a noisy curvature
MIN_STEERING_RATE = 1e-3  # [rad/s] avoids a division by zero


@dataclass(frozen=True, slots=True)
class LateralConfig:
    """Gains of the steering cascade; chosen by step responses of the kinematic bicycle."""

    offset_time: float = 1.0  # Time constant with which an offset is driven out [s]
    heading_time: float = 0.45  # Time constant with which a heading error is driven out [s]
    max_approach: float = 0.5  # Largest angle at which the lane's centre is approached [rad]

    def __post_init__(self) -> None:
        check_positive(ValueError, **{name: getattr(self, name) for name in self.__slots__})


def parallel_curvature(curvature: float, offset: float) -> float:
    """Curvature [1/m] of the line that runs `offset` [m] to the left of a line of `curvature`."""
    return curvature / max(MIN_CONTRACTION, 1.0 - curvature * offset)


def steer(
    config: LateralConfig,
    lane: LaneEstimate,
    target: float,
    target_rate: float,
    speed: float,
    previous: float,
    limits: ActuatorLimits,
) -> float:
    """Steering angle that brings the car to an offset and keeps it there [rad].

    With e the offset error, r the rate of the target offset, psi the heading error and kappa the
    previewed curvature:

        psi_ref = sat(r / v - e / (v · T_e))
        delta = atan(L · (kappa + (psi_ref - psi) / (v · T_psi)))

    so that e decays with T_e and psi with T_psi whatever the speed. Beside the lane's centre its
    curvature is that of a parallel line, kappa / (1 - kappa · e). psi is the heading error that
    there will be once the steering, at its full rate, has come back from where it is (`previous`)
    to the lane's curvature: a slow car turns far within that time. `target` [m] and `target_rate`
    [m/s] are of the offset to the left of the home lane's centre.
    """
    v = max(speed, MIN_SPEED)
    error = lane.lateral_offset - target
    approach = math.atan2(target_rate, max(speed, MIN_RATE_SPEED))
    approach -= math.atan2(error / config.offset_time, v)
    heading = max(-config.max_approach, min(config.max_approach, approach))
    curvature = lane.curvature + lane.curvature_rate * v * PREVIEW_TIME
    curvature = parallel_curvature(curvature, lane.lateral_offset)
    reach = max(speed, MIN_TURN_SPEED) * config.heading_time
    excess = previous - math.atan(limits.wheelbase * curvature)
    unwinding = abs(excess) / max(limits.max_steering_rate, MIN_STEERING_RATE)
    swing = 0.5 * speed * excess / limits.wheelbase * unwinding
    turn = curvature + (heading - lane.heading_error - swing) / reach
    return math.atan(limits.wheelbase * turn)
