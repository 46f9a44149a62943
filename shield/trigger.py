"""When the planner has to help: by what the driver is about to do, or by where the car is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from shield.errors import (
    InvalidLimits,
    InvalidProblem,
    as_array,
    check_numbers,
    check_positive,
)
from shield.estimation.clearance import ClearanceEstimate
from shield.estimation.lane import LaneEstimate, LaneGeometry

__all__ = ["Risk", "RiskTrigger", "TriggerConfig"]

TriggerForm = Literal["predicted", "printed"]

MAX_AGE = 0.5  # [s] of an estimate, from which the sensor counts as lost: five scans at 10 Hz
SIGMAS = 1.0  # deviations by which estimates are inflated to the risky side
# More clearance [m] and less deviation [m] than the thresholds that a risky state is left with, and
# time [s] for which no reason may appear before
CLEARANCE_HYSTERESIS, LANE_HYSTERESIS, HOLD_TIME = 0.5, 0.2, 0.5
STALL_TIME = 4.0  # [s] for which a car that makes no progress stands: a pedestrian has crossed
STALL_SPEED = 1.0  # [m/s] below which the car counts as standing; plans creep at 2 m/s


@dataclass(frozen=True, slots=True)
class TriggerConfig:
    """When a state counts as risky.

    Attributes:
        form: By prediction: what the driver is about to do would soon need the shield, or the car
            makes no progress. Or as printed, Eq. (dal_trigger) of the paper with uncertainty: by
            clearance and distance to the lane's centre.
        clearance: Clearance below which a state is risky as printed [m]. Default: d_trigger of
            Table II.
        lane_deviation: Distance to the nearest lane centre above which a state is risky as printed
            [m]. Default: e_lane of Table II, 120 px read as 1.2 m.
        passing_lane: Whether the passing lane's centre is admissible, too; the paper has one lane.

    Raises:
        InvalidLimits: A value is not finite or has the wrong sign.
    """

    form: TriggerForm = "predicted"
    clearance: float = 3.0
    lane_deviation: float = 1.2
    passing_lane: bool = True

    def __post_init__(self) -> None:
        """Check every field."""
        if self.form not in get_args(TriggerForm):
            raise InvalidLimits(
                f"`form` must be one of {get_args(TriggerForm)}. Got {self.form!r}."
            )
        check_positive(InvalidLimits, clearance=self.clearance, lane_deviation=self.lane_deviation)
        if self.lane_deviation <= LANE_HYSTERESIS:
            least = f"above {LANE_HYSTERESIS}"
            raise InvalidLimits(f"`lane_deviation` must be {least}. Got {self.lane_deviation!r}.")


@dataclass(frozen=True, slots=True)
class Risk:
    """Verdict of one step.

    Attributes:
        risky: Whether the planner has to help.
        reasons: Any of "lidar_lost", "lane_lost"; "shield", "stalled" by prediction; "clearance",
            "lane_deviation" as printed; or "hold" alone while the verdict outlives its reasons.
            Empty when not risky.
        lane_deviation: Distance to the nearest admissible lane centre [m].
    """

    risky: bool
    reasons: tuple[str, ...]
    lane_deviation: float


class RiskTrigger:
    """Decides by what is about to happen, or on inflated estimates, with a hold time.

    Not knowing is a risk: an estimate that is invalid or too old. By prediction a state is risky
    as well where the driver's next commands would need the shield, or nothing moves on for long.
    As printed, where ``clearance - σ`` falls below its threshold, or ``deviation + σ`` rises above
    its own. It stays so until no reason, judged by the stricter thresholds of the hysteresis, has
    appeared for half a second.

    Args:
        config: The form, and its thresholds.
        dt: Control period [s].
        lane_centres: Admissible lane centres, measured left of the home lane's [m].

    Raises:
        InvalidLimits: `dt`, `config` or a lane centre makes no sense, or there is no lane centre.
        InvalidProblem: `lane_centres` does not hold numbers.
    """

    def __init__(
        self,
        config: TriggerConfig,
        dt: float,
        lane_centres: Sequence[float] = LaneGeometry().centres,
    ) -> None:
        check_positive(InvalidLimits, dt=dt)
        if not isinstance(config, TriggerConfig):
            raise InvalidLimits(f"`config` must be a TriggerConfig. Got {config!r}.")
        centres = as_array("lane_centres", lane_centres)
        if centres.ndim != 1 or not centres.size or not np.isfinite(centres).all():
            raise InvalidLimits(f"`lane_centres` must be finite numbers. Got {lane_centres!r}.")
        self.config = config
        self._centres: list[float] = centres.tolist()
        # Rounded first: 0.5 / 0.1 is five, whatever the last bit.
        self._hold_steps, self._stall_steps = (
            math.ceil(round(time / dt, 6)) for time in (HOLD_TIME, STALL_TIME)
        )
        self.reset()

    def reset(self) -> None:
        """Return to the quiet state."""
        self._quiet_steps = self._slow_steps = 0
        self._risky = False

    def update(
        self,
        clearance: ClearanceEstimate,
        lane: LaneEstimate,
        speed: float = math.inf,
        needs_shield: bool = False,
    ) -> Risk:
        """Judge one step.

        Args:
            clearance: Tracked clearance.
            lane: Tracked lane pose.
            speed: Own speed [m/s]; infinite where it is not known: then no car stalls.
            needs_shield: Whether the driver's next commands would need the shield.

        Raises:
            InvalidProblem: An argument is not of its type.
        """
        if not isinstance(clearance, ClearanceEstimate):
            raise InvalidProblem(f"`clearance` must be a ClearanceEstimate. Got {clearance!r}.")
        if not isinstance(lane, LaneEstimate):
            raise InvalidProblem(f"`lane` must be a LaneEstimate. Got {lane!r}.")
        check_numbers(speed=speed)
        self._slow_steps = self._slow_steps + 1 if abs(speed) < STALL_SPEED else 0
        deviation = min(abs(lane.lateral_offset - centre) for centre in self._centres)
        reasons = self._reasons(clearance, lane, deviation, needs_shield)
        if reasons:
            self._risky, self._quiet_steps = True, 0
        elif self._risky:
            self._quiet_steps += 1
            if self._quiet_steps > self._hold_steps:
                self._risky = False
            else:
                reasons = ("hold",)
        return Risk(self._risky, reasons, deviation)

    def _reasons(
        self,
        clearance: ClearanceEstimate,
        lane: LaneEstimate,
        deviation: float,
        needs_shield: bool,
    ) -> tuple[str, ...]:
        """Return what is risky now; comparisons are written so that NaN counts as risky."""
        config, margin = self.config, float(self._risky)
        good = {
            "lidar_lost": clearance.valid and clearance.age <= MAX_AGE,
            "lane_lost": lane.valid and lane.age <= MAX_AGE,
        }
        if config.form == "predicted":
            good |= {"shield": not needs_shield, "stalled": self._slow_steps <= self._stall_steps}
        else:
            near = config.clearance + margin * CLEARANCE_HYSTERESIS
            far = config.lane_deviation - margin * LANE_HYSTERESIS
            good |= {
                "clearance": clearance.clearance - SIGMAS * clearance.std >= near,
                "lane_deviation": deviation + SIGMAS * lane.offset_std <= far,
            }
        return tuple(reason for reason, holds in good.items() if not holds)
