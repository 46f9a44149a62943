"""When the planner has to help: near an obstacle, off the lane or about to be, blind, stalled."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shield.errors import (
    InvalidLimits,
    InvalidProblem,
    as_array,
    check_numbers,
    check_positive,
    check_within,
)
from shield.estimation.clearance import ClearanceEstimate
from shield.estimation.lane import LaneEstimate, LaneGeometry

__all__ = ["Risk", "RiskTrigger", "TriggerConfig"]

MAX_AGE = 0.5  # [s] of an estimate, from which the sensor counts as lost: five scans at 10 Hz
STALL_SPEED = 1.0  # [m/s] below which the car counts as standing; plans creep at 2 m/s


@dataclass(frozen=True, slots=True)
class TriggerConfig:
    """Thresholds of the risk trigger, Eq. (dal_trigger) of the paper with uncertainty.

    Attributes:
        clearance: Clearance below which a state is risky [m]. Default: d_trigger of Table II.
        lane_deviation: Distance to the nearest lane centre above which a state is risky [m].
            Default: e_lane of Table II, 120 px read as 1.2 m.
        sigma_factor: Standard deviations by which estimates are inflated to the risky side.
        clearance_hysteresis: Extra clearance needed to leave the risky state [m].
        lane_hysteresis: Distance below `lane_deviation` needed to leave the risky state [m].
        hold_time: Time for which no reason may appear before the risky state is left [s].
        stall_time: A car that stands for this time has stalled [s]; None for never. Default: a
            pedestrian has crossed by then.
        preview_time: A car whose heading leads `lane_deviation` beyond the outermost lanes within
            this time is leaving them: the time to line crossing as distance by lateral speed, which
            tells shortly before the line (doi:10.1016/S0001-4575(99)00048-2). None for never [s].
            Default: the planner's lane energy looks as far ahead.
        passing_lane: Whether the passing lane's centre is admissible, too; the paper has one lane.

    Raises:
        InvalidLimits: A value is not finite or has the wrong sign.
    """

    clearance: float = 3.0
    lane_deviation: float = 1.2
    sigma_factor: float = 1.0
    clearance_hysteresis: float = 0.5
    lane_hysteresis: float = 0.2
    hold_time: float = 0.5
    stall_time: float | None = 4.0
    preview_time: float | None = 1.0
    passing_lane: bool = True

    def __post_init__(self) -> None:
        """Check every field."""
        check_positive(InvalidLimits, clearance=self.clearance, lane_deviation=self.lane_deviation)
        for name in ("stall_time", "preview_time"):
            if getattr(self, name) is not None:
                check_positive(InvalidLimits, **{name: getattr(self, name)})
        for name in ("sigma_factor", "clearance_hysteresis", "lane_hysteresis", "hold_time"):
            check_within(InvalidLimits, 0.0, math.inf, **{name: getattr(self, name)})
        if self.lane_hysteresis >= self.lane_deviation:
            raise InvalidLimits(f"`lane_hysteresis` must be below `lane_deviation`. Got {self!r}.")


@dataclass(frozen=True, slots=True)
class Risk:
    """Verdict of one step.

    Attributes:
        risky: Whether the planner has to help.
        reasons: Any of "clearance", "lane_deviation", "leaving", "lidar_lost", "lane_lost",
            "stalled", or "hold" alone while the verdict outlives its reasons; empty when not risky.
        lane_deviation: Distance to the nearest admissible lane centre [m].
    """

    risky: bool
    reasons: tuple[str, ...]
    lane_deviation: float


class RiskTrigger:
    """Decides on inflated estimates, with hysteresis and a hold time.

    A state becomes risky when ``clearance - k σ`` falls below its threshold, ``deviation + k σ``
    rises above its own, or an estimate is invalid or too old: not knowing is a risk. So is a
    heading that leads out of the lanes: a car that crosses the outermost lane at an angle is near
    its centre for a moment. A car that has stalled needs help as well: its driver may see no way
    on. The state stays risky until no reason, judged by the stricter thresholds of the hysteresis,
    has appeared for `hold_time`.

    Args:
        config: Thresholds.
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
        self._hold_steps = _periods(config.hold_time, dt)
        self._stall_steps = _periods(config.stall_time, dt)
        self.reset()

    def reset(self) -> None:
        """Return to the quiet state."""
        self._quiet_steps = self._slow_steps = 0
        self._risky = False

    def update(
        self, clearance: ClearanceEstimate, lane: LaneEstimate, speed: float | None = None
    ) -> Risk:
        """Judge one step.

        Args:
            clearance: Tracked clearance.
            lane: Tracked lane pose.
            speed: Own speed [m/s], if known: without it no car stalls or leaves its lanes.

        Raises:
            InvalidProblem: An argument is not of its type.
        """
        if not isinstance(clearance, ClearanceEstimate):
            raise InvalidProblem(f"`clearance` must be a ClearanceEstimate. Got {clearance!r}.")
        if not isinstance(lane, LaneEstimate):
            raise InvalidProblem(f"`lane` must be a LaneEstimate. Got {lane!r}.")
        check_numbers(speed=0.0 if speed is None else speed)
        slow = speed is not None and abs(speed) < STALL_SPEED
        self._slow_steps = self._slow_steps + 1 if slow else 0
        deviation = min(abs(lane.lateral_offset - centre) for centre in self._centres)
        reasons = self._reasons(clearance, lane, deviation, speed)
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
        speed: float | None,
    ) -> tuple[str, ...]:
        """Return what is risky now; comparisons are written so that NaN counts as risky."""
        config, margin = self.config, float(self._risky)
        near = config.clearance + margin * config.clearance_hysteresis
        far = config.lane_deviation - margin * config.lane_hysteresis
        good = {
            "lidar_lost": clearance.valid and clearance.age <= MAX_AGE,
            "clearance": clearance.clearance - config.sigma_factor * clearance.std >= near,
            "lane_lost": lane.valid and lane.age <= MAX_AGE,
            "lane_deviation": deviation + config.sigma_factor * lane.offset_std <= far,
            "leaving": self._beyond(lane, speed) <= far,
            "stalled": self._slow_steps <= self._stall_steps,
        }
        return tuple(reason for reason, holds in good.items() if not holds)

    def _beyond(self, lane: LaneEstimate, speed: float | None) -> float:
        """Distance beyond the outermost lane centres that the preview time leads to [m]."""
        preview_time = self.config.preview_time
        if preview_time is None or speed is None or not math.isfinite(speed):
            return -math.inf
        if not math.isfinite(lane.heading_error):
            return math.inf
        sideways = abs(speed) * math.sin(lane.heading_error)
        ahead = lane.lateral_offset + preview_time * sideways
        return max(min(self._centres) - ahead, ahead - max(self._centres))


def _periods(time: float | None, dt: float) -> float:
    """Control periods in a time; rounded first: 0.5 / 0.1 is five, whatever the last bit."""
    return math.inf if time is None else math.ceil(round(time / dt, 6))
