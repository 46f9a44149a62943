"""Steering: a cascade of lateral position, lateral speed and lateral acceleration."""

import math

from shield import ActuatorLimits, LaneEstimate

# [s] time constants with which an offset and a lateral speed are driven out, and by which wheels
# and car are late behind a set-point; chosen by step responses of bicycle and follower
OFFSET_TIME, RATE_TIME, LAG = 1.2, 0.45, 0.25
SHIFT_RATE = 1.8  # [m/s] fastest way across the road
SHIFT_ACCELERATION = 1.2  # [m/s^2] with which it ends; what it begins with is a quarter more
MAX_APPROACH = 0.35  # [rad] at which a lane is approached; beyond 0.45 the camera loses it
MIN_SPEED = 5.0  # [m/s] below which the gains stop growing
MIN_CONTRACTION = 0.4  # of the distance to the centre of a bend; bounds a noisy curvature


def parallel_curvature(curvature: float, offset: float) -> float:
    """Curvature [1/m] of the line that runs `offset` [m] to the left of a line of `curvature`."""
    return curvature / max(MIN_CONTRACTION, 1.0 - curvature * offset)


def steer(
    lane: LaneEstimate, target: float, speed: float, previous: float, limits: ActuatorLimits
) -> float:
    """Steering angle that brings the car to an offset and keeps it there [rad].

    With e the offset error, psi the heading error and kappa the previewed curvature:

        r = -sgn(e) min(|e| / T_e, sqrt(2 A (|e| - A T_e^2 / 2)), R)
        delta = atan(L · (kappa + sat((r / v - psi) / (v · T_r))))

    so that a change of lane ends with the acceleration A, and e and the lateral speed decay with
    T_e and T_r whatever the speed. Beside the lane's centre its curvature is that of a parallel
    line, kappa / (1 - kappa · e). e and psi are those that there will be once the wheels have come
    back from where they are (`previous`) to the lane's curvature. `target` is the offset to the
    left of the home lane's centre [m].
    """
    v = max(speed, MIN_SPEED)
    curvature = lane.curvature + lane.curvature_rate * v * LAG
    curvature = parallel_curvature(curvature, lane.lateral_offset)
    excess = previous - math.atan(limits.wheelbase * curvature)
    late = LAG + 0.5 * abs(excess) / limits.max_steering_rate
    turned = speed * late * excess / limits.wheelbase
    heading = lane.heading_error + turned
    error = lane.lateral_offset - target
    error += speed * LAG * math.sin(lane.heading_error + 0.5 * turned)
    size, soft = abs(error), SHIFT_ACCELERATION * OFFSET_TIME**2
    rate = size / OFFSET_TIME
    if size > soft:
        rate = math.sqrt(2.0 * SHIFT_ACCELERATION * (size - 0.5 * soft))
    approach = -math.copysign(min(rate, SHIFT_RATE), error) / v
    approach = max(-MAX_APPROACH, min(MAX_APPROACH, approach))
    turn = (approach - heading) / (v * RATE_TIME)
    most = 1.25 * SHIFT_ACCELERATION / max(speed, 1.0) ** 2
    return math.atan(limits.wheelbase * (curvature + max(-most, min(most, turn))))
