"""Steering: a cascade of offset, heading and curvature."""

from __future__ import annotations

import math
from dataclasses import dataclass

from shield import ActuatorLimits, LaneEstimate


@dataclass(frozen=True, slots=True)
class LateralConfig:
    """Gains of the steering cascade; chosen by step responses of the kinematic bicycle.

    Attributes:
        offset_time: Time constant with which an offset is driven out [s].
        heading_time: Time constant with which a heading error is driven out [s].
        max_approach: Largest angle at which the lane's centre is approached [rad].
        preview_time: Look-ahead of the curvature feed-forward [s].
        min_speed: Below which the offset's gain stops growing [m/s].
        min_turn_speed: The same of the heading's [m/s]: the inner loop is the faster one.
    """

    offset_time: float = 1.0
    heading_time: float = 0.45
    max_approach: float = 0.5
    preview_time: float = 0.15
    min_speed: float = 3.5
    min_turn_speed: float = 2.0

    def __post_init__(self) -> None:
        for name in ("offset_time", "heading_time", "max_approach", "min_speed", "min_turn_speed"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"`{name}` must be positive. Got {getattr(self, name)}.")


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

    With e the offset error, r the rate of the wanted offset, psi the heading error and kappa the
    previewed curvature:

        psi_ref = sat(r / v - e / (v · T_e))
        delta = atan(L · (kappa + (psi_ref - psi) / (v · T_psi)))

    so that e decays with T_e and psi with T_psi whatever the speed. Beside the lane's centre its
    curvature is that of a parallel line, kappa / (1 - kappa · e). psi is the heading error that
    there will be once the steering, at its full rate, has come back from where it is to the lane's
    curvature: a slow car turns far within that time.

    Args:
        config: Gains.
        lane: Estimated lane pose and curvature.
        target: Wanted offset to the left of the home lane's centre [m].
        target_rate: Speed at which that offset moves to the left [m/s].
        speed: Forward speed [m/s].
        previous: Steering angle now [rad].
        limits: Wheelbase and steering rate.
    """
    v = max(speed, config.min_speed)
    error = lane.lateral_offset - target
    approach = math.atan2(target_rate, max(speed, 1.0)) - math.atan2(error / config.offset_time, v)
    heading = max(-config.max_approach, min(config.max_approach, approach))
    curvature = lane.curvature + lane.curvature_rate * v * config.preview_time
    curvature /= max(0.4, 1.0 - curvature * lane.lateral_offset)
    reach = max(speed, config.min_turn_speed) * config.heading_time
    excess = previous - math.atan(limits.wheelbase * curvature)
    unwinding = abs(excess) / max(limits.max_steering_rate, 1e-3)
    swing = 0.5 * speed * excess / limits.wheelbase * unwinding
    turn = curvature + (heading - lane.heading_error - swing) / reach
    return math.atan(limits.wheelbase * turn)
