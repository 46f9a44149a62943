"""When the planner has to help: something near, astray or about to be, blind, or stuck."""

import math
from dataclasses import dataclass

import numpy as np

from shield.arguments import as_array, as_float, check_positive, is_number
from shield.errors import InvalidLimits
from shield.estimation.clearance import ClearanceEstimate
from shield.estimation.lane import LaneEstimate

__all__ = ["Risk", "RiskTrigger", "TriggerConfig"]


@dataclass(frozen=True, slots=True)
class TriggerConfig:
    """Thresholds of the risk trigger, Eq. (dal_trigger) of the paper with uncertainty.

    Attributes:
        clearance: Clearance below which a state is risky [m]. Default: d_trigger of Table II.
        lane_deviation: Distance to the nearest lane centre above which a state is risky [m].
            Default: e_lane of Table II, 120 px read as 1.2 m.
        lane_centres: Admissible lane centres, measured left of the home lane's [m]. Default: home
            lane and passing lane, 3.5 m wide.
        sigma_factor: Standard deviations by which estimates are inflated to the risky side.
        clearance_hysteresis: Extra clearance needed to leave the risky state [m].
        lane_hysteresis: Distance below `lane_deviation` needed to leave the risky state [m].
        hold_time: Time for which no reason may appear before the risky state is left [s].
        max_age: Age of an estimate from which the sensor counts as lost [s].
        stall_speed: A car slower than this has stalled after `stall_time` [m/s].
        stall_time: None for never [s]. Default: who crosses the road has gone by then.
        preview_time: A car whose heading leads `lane_deviation` beyond the outermost lanes within
            this time is leaving them: the time to line crossing as distance by lateral speed, which
            tells shortly before the line (doi:10.1016/S0001-4575(99)00048-2). None for never [s].
            Default: the planner's lane energy looks as far ahead.

    Raises:
        InvalidLimits: A value is not finite or has the wrong sign, or there is no lane centre.
        InvalidProblem: `lane_centres` does not hold numbers.
    """

    clearance: float = 3.0
    lane_deviation: float = 1.2
    lane_centres: tuple[float, ...] = (0.0, 3.5)
    sigma_factor: float = 1.0
    clearance_hysteresis: float = 0.5
    lane_hysteresis: float = 0.2
    hold_time: float = 0.5
    max_age: float = 0.5
    stall_speed: float = 1.0
    stall_time: float | None = 4.0
    preview_time: float | None = 1.0

    def __post_init__(self) -> None:
        """Refuse impossible thresholds, naming the field and the value received."""
        check_positive(
            InvalidLimits,
            clearance=self.clearance,
            lane_deviation=self.lane_deviation,
            max_age=self.max_age,
            stall_speed=self.stall_speed,
        )
        for name in ("stall_time", "preview_time"):
            if getattr(self, name) is not None:
                check_positive(InvalidLimits, **{name: getattr(self, name)})
        for name in ("sigma_factor", "clearance_hysteresis", "lane_hysteresis", "hold_time"):
            value = getattr(self, name)
            if not is_number(value) or not 0.0 <= as_float(value) < math.inf:
                raise InvalidLimits(f"`{name}` must be at least 0 and finite. Got {value!r}.")
        if self.lane_hysteresis >= self.lane_deviation:
            raise InvalidLimits(
                "`lane_hysteresis` must be below `lane_deviation`. "
                f"Got {self.lane_hysteresis!r} and {self.lane_deviation!r}."
            )
        centres = as_array("lane_centres", self.lane_centres)
        if centres.ndim != 1 or not centres.size or not np.isfinite(centres).all():
            raise InvalidLimits(
                f"`lane_centres` must be finite and not empty. Got {self.lane_centres!r}."
            )
        object.__setattr__(self, "lane_centres", tuple(centres.tolist()))


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
    heading that leads out of the lanes: a car that crosses the last one at an angle is near its
    centre for a moment. A car that has stalled needs help as well: it may wait for ever where
    whoever drives it sees no way. The state stays risky until no reason, judged by the stricter
    thresholds of the hysteresis, has appeared for `hold_time`.

    Args:
        config: Thresholds.
        dt: Control period [s].

    Raises:
        InvalidLimits: `dt` is not positive and finite, or `config` is something else.
    """

    def __init__(self, config: TriggerConfig, dt: float) -> None:
        check_positive(InvalidLimits, dt=dt)
        if not isinstance(config, TriggerConfig):
            raise InvalidLimits(f"`config` must be a TriggerConfig. Got {config!r}.")
        self.config = config
        self._hold_steps = _periods(config.hold_time, dt)
        self._stall_steps = math.inf
        if config.stall_time is not None:
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
        """
        config = self.config
        slow = speed is not None and abs(speed) < config.stall_speed
        self._slow_steps = self._slow_steps + 1 if slow else 0
        deviation = min(abs(lane.lateral_offset - centre) for centre in config.lane_centres)
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
        config = self.config
        margin = config.clearance_hysteresis if self._risky else 0.0
        slack = config.lane_hysteresis if self._risky else 0.0
        reasons = []
        if not (clearance.valid and clearance.age <= config.max_age):
            reasons.append("lidar_lost")
        free = clearance.clearance - config.sigma_factor * clearance.std
        if not free >= config.clearance + margin:
            reasons.append("clearance")
        if not (lane.valid and lane.age <= config.max_age):
            reasons.append("lane_lost")
        if not deviation + config.sigma_factor * lane.offset_std <= config.lane_deviation - slack:
            reasons.append("lane_deviation")
        if not self._beyond(lane, speed) <= config.lane_deviation - slack:
            reasons.append("leaving")
        if self._slow_steps > self._stall_steps:
            reasons.append("stalled")
        return tuple(reasons)

    def _beyond(self, lane: LaneEstimate, speed: float | None) -> float:
        """How far beyond the outermost lane centres the heading leads in the preview time [m]."""
        config = self.config
        if config.preview_time is None or speed is None or not math.isfinite(speed):
            return -math.inf
        if not math.isfinite(lane.heading_error):
            return math.inf
        sideways = abs(speed) * math.sin(lane.heading_error)
        ahead = lane.lateral_offset + config.preview_time * sideways
        return max(min(config.lane_centres) - ahead, ahead - max(config.lane_centres))


def _periods(time: float, dt: float) -> int:
    """Control periods in a time; rounded first: 0.5 / 0.1 is five, whatever the last bit."""
    return math.ceil(round(time / dt, 6))
