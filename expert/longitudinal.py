"""Speed: cruise, slow down for bends, keep a distance in which the car can stop."""

import math
from dataclasses import dataclass

from expert.lateral import parallel_curvature
from shield import LaneEstimate
from shield.errors import check_positive

PREVIEW = 20.0  # [m] stretch of lane whose curvature counts: two seconds at cruise speed
CREEP_SPEED = 0.8  # [m/s] at which the car still steers free of what it has stopped behind
CREEP_GAP = 1.2  # [m] distance to it at which the car stands for good
STRAIGHT = 1e-6  # [1/m] less curvature than that is none


@dataclass(frozen=True, slots=True)
class LongitudinalConfig:
    """How fast the expert drives."""

    cruise_speed: float = 9.0  # On a free straight [m/s]
    lateral_acceleration: float = 2.0  # Comfortable in bends [m/s^2]; ISO 22179 suggests 2 to 2.5
    deceleration: float = 2.0  # Planned when something is ahead [m/s^2]
    standoff: float = 4.0  # Distance to stop behind an obstacle [m]
    blind_speed: float = 3.0  # While the lane is not seen or the scan is unusable [m/s]

    def __post_init__(self) -> None:
        check_positive(ValueError, **{name: getattr(self, name) for name in self.__slots__})


def bend_speed(config: LongitudinalConfig, lane: LaneEstimate) -> float:
    """Speed at which the lane's bends are comfortable, sqrt(a_lat / |kappa|), at most cruise [m/s].

    While the lane is not seen, `blind_speed`.
    """
    if not lane.valid:
        return config.blind_speed
    end = lane.curvature + lane.curvature_rate * PREVIEW
    here = parallel_curvature(lane.curvature, lane.lateral_offset)
    bend = max(abs(here), abs(end), STRAIGHT)
    return min(config.cruise_speed, math.sqrt(config.lateral_acceleration / bend))


def stopping_speed(config: LongitudinalConfig, gap: float) -> float:
    """Speed from which the car stops in front of what is `gap` [m] ahead [m/s].

    v = max(v_creep, sqrt(2 · a · (gap - standoff))), and 0 once the gap is below `CREEP_GAP`.
    """
    if gap <= CREEP_GAP:
        return 0.0
    stop = math.sqrt(2.0 * config.deceleration * max(0.0, gap - config.standoff))
    return max(stop, CREEP_SPEED)
