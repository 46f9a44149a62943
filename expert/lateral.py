"""Steering: a cascade of offset, heading and curvature."""

import math

from shield import ActuatorLimits, LaneEstimate

# [s] time constants with which an offset and a heading error are driven out; chosen by step
# responses of the kinematic bicycle
OFFSET_TIME, HEADING_TIME = 1.0, 0.45
MAX_APPROACH = 0.5  # [rad] largest angle at which the lane's centre is approached
PREVIEW_TIME = 0.15  # [s] look-ahead of the curvature feed-forward
MIN_SPEED = 3.5  # [m/s] below which the offset's gain stops growing
MIN_TURN_SPEED = 2.0  # [m/s] the same of the heading's gain: the inner loop is the faster one
MIN_RATE_SPEED = 1.0  # [m/s] below which a moving target asks for no larger angle
MIN_CONTRACTION = 0.4  # of the distance to the centre of a bend; bounds a noisy curvature
MIN_STEERING_RATE = 1e-3  # [rad/s] avoids a division by zero


def parallel_curvature(curvature: float, offset: float) -> float:
    """Curvature [1/m] of the line that runs `offset` [m] to the left of a line of `curvature`."""
    return curvature / max(MIN_CONTRACTION, 1.0 - curvature * offset)


def steer(
    lane: LaneEstimate,
    reference: tuple[float, float, float],
    speed: float,
    previous: float,
    limits: ActuatorLimits,
) -> float:
    """Steering angle that brings the car to an offset and keeps it there [rad].

    With e the offset error, r and a the rate and acceleration of the target offset, psi the heading
    error and kappa the previewed curvature:

        psi_ref = sat(r / v - e / (v · T_e))
        delta = atan(L · (kappa + a / v² + (psi_ref - psi) / (v · T_psi)))

    so that e decays with T_e and psi with T_psi whatever the speed. Beside the lane's centre its
    curvature is that of a parallel line, kappa / (1 - kappa · e). psi is the heading error that
    there will be once the steering, at its full rate, has come back from where it is (`previous`)
    to the lane's curvature: a slow car turns far within that time. `reference` is the target offset
    to the left of the home lane's centre [m], with its rate [m/s] and acceleration [m/s²].
    """
    v = max(speed, MIN_SPEED)
    target, rate, acceleration = reference
    error = lane.lateral_offset - target
    approach = math.atan2(rate, max(speed, MIN_RATE_SPEED))
    approach -= math.atan2(error / OFFSET_TIME, v)
    heading = max(-MAX_APPROACH, min(MAX_APPROACH, approach))
    curvature = lane.curvature + lane.curvature_rate * v * PREVIEW_TIME
    curvature = parallel_curvature(curvature, lane.lateral_offset)
    reach = max(speed, MIN_TURN_SPEED) * HEADING_TIME
    excess = previous - math.atan(limits.wheelbase * curvature)
    unwinding = abs(excess) / max(limits.max_steering_rate, MIN_STEERING_RATE)
    swing = 0.5 * speed * excess / limits.wheelbase * unwinding
    turn = curvature + acceleration / v**2 + (heading - lane.heading_error - swing) / reach
    return math.atan(limits.wheelbase * turn)
