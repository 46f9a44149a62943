"""What a promise of passive safety rests on (A1-A11 of docs/passive_safety.md)."""

import math
from dataclasses import asdict, dataclass
from typing import Literal

from shield.errors import InvalidLimits, check_positive, check_within

__all__ = ["Assumptions"]


@dataclass(frozen=True, slots=True)
class Assumptions:
    """How others move, what the scanner and the lane estimate miss, how the car brakes.

    Attributes:
        level: `P0`: people walk in any direction, vehicles stay in their lane and go its way. `P1`:
            everything moves in any direction with up to `object_speed`.
        person_speed: Largest speed of a person [m/s] (A1); a brisk walk is 1.6.
        person_acceleration: Largest acceleration of one [m/s²] (A1); gait initiation stays below 1.
        object_speed: Largest speed of anything on level P1 [m/s] (A1).
        range_error: Error of a range [m] (A3).
        delay: Age of a scan when the command that answers it begins to act [s] (A5).
        braking: Deceleration that the car keeps [m/s²] (A6), at most the limit's.
        steering_lag: Delay with which the wheels follow the steering [s] (A6).
        understeer: K in yaw rate = v tan δ / (L (1 + K v²)) [s²/m²] (A6).
        tracking_error: Distance from the predicted path [m] (A6).
        lane_sigmas, lane_error: Error of the lane estimate, in its standard deviations, and beyond
            them, which repeated sightings do not reduce [m] (A9).
        lane_heading: Heading error up to which it holds [rad] (A9): then the lane is in view.

    Raises:
        InvalidLimits: A value is out of range, or there is no such level.
    """

    level: Literal["P0", "P1"] = "P0"
    person_speed: float = 2.0
    person_acceleration: float = 1.0
    object_speed: float = 2.5
    range_error: float = 0.1
    delay: float = 0.0
    braking: float = 6.0
    steering_lag: float = 0.05
    understeer: float = 0.002
    tracking_error: float = 0.1
    lane_sigmas: float = 3.0
    lane_error: float = 0.2
    lane_heading: float = 0.45

    def __post_init__(self) -> None:
        """Check every field."""
        values = asdict(self)
        if values.pop("level") not in ("P0", "P1"):
            raise InvalidLimits(f"`level` must be P0 or P1. Got {self.level!r}.")
        check_positive(InvalidLimits, braking=values.pop("braking"))
        check_within(InvalidLimits, 0.0, math.inf, **values)
