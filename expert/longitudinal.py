"""Speed: cruise, slow down for bends, keep a distance in which the car can stop."""

from __future__ import annotations

import math
from dataclasses import dataclass

from shield import LaneEstimate


@dataclass(frozen=True, slots=True)
class LongitudinalConfig:
    """How fast the expert drives.

    Attributes:
        cruise_speed: On a free straight [m/s].
        lateral_acceleration: Comfortable in bends [m/s^2]; ISO 22179 suggests 2 to 2.5.
        acceleration: Comfortable when there is room again [m/s^2]; the actuators can do more.
        deceleration: Planned when something is ahead [m/s^2].
        standoff: Distance to stop behind an obstacle [m].
        creep_speed: At which the car still steers free of it inside that distance [m/s].
        creep_gap: Distance at which it stands for good [m].
        blind_speed: While the lane is not seen [m/s].
        preview: Stretch of lane whose curvature counts [m].
        pace_time: Time constant with which the speed follows the estimated bend [s]: the estimate
            is noisy, and who follows its noise makes the passengers nod.
    """

    cruise_speed: float = 9.0
    lateral_acceleration: float = 2.0
    acceleration: float = 1.5
    deceleration: float = 2.0
    standoff: float = 4.0
    creep_speed: float = 0.8
    creep_gap: float = 1.2
    blind_speed: float = 3.0
    preview: float = 20.0
    pace_time: float = 0.6

    def __post_init__(self) -> None:
        for name in (
            "cruise_speed",
            "lateral_acceleration",
            "acceleration",
            "deceleration",
            "standoff",
            "pace_time",
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"`{name}` must be positive. Got {getattr(self, name)}.")


def bend_speed(config: LongitudinalConfig, lane: LaneEstimate) -> float:
    """Speed at which the lane's bends are comfortable, sqrt(a_lat / |kappa|), at most cruise [m/s].

    While the lane is not seen, `blind_speed`.

    Args:
        config: How fast the expert drives.
        lane: Estimated lane pose and curvature.
    """
    if not lane.valid:
        return config.blind_speed
    end = lane.curvature + lane.curvature_rate * config.preview
    here = lane.curvature / max(0.4, 1.0 - lane.curvature * lane.lateral_offset)
    bend = max(abs(here), abs(end), 1e-6)
    return min(config.cruise_speed, math.sqrt(config.lateral_acceleration / bend))


def stopping_speed(config: LongitudinalConfig, gap: float) -> float:
    """Speed from which the car stops in front of what is ahead [m/s].

        v = max(v_creep, sqrt(2 · a · (gap - standoff))), and 0 once the gap is below `creep_gap`.

    Args:
        config: How fast the expert drives.
        gap: Free distance ahead in the lane that is being driven [m].
    """
    if gap <= config.creep_gap:
        return 0.0
    stop = math.sqrt(2.0 * config.deceleration * max(0.0, gap - config.standoff))
    return max(stop, config.creep_speed)
