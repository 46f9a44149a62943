"""The expert: a finite-state machine over four driving modes (paper, Sec. FSM-aware replay)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from expert.crossing import CrossingConfig, CrossingWatch, Pedestrian
from expert.lane_map import LIDAR_FORWARD, LaneMap
from expert.lateral import LateralConfig, steer
from expert.longitudinal import LongitudinalConfig, bend_speed, stopping_speed
from expert.modes import Mode
from expert.neighbour import Neighbour
from shield import ActuatorLimits, LaneEstimate

Array = NDArray[np.float64]

_STUCK_AFTER = 3
_INSIDE = 1.0 - 1e-9


@dataclass(frozen=True, slots=True)
class ExpertConfig:
    """Thresholds of the state machine and the gains of its controllers.

    Attributes:
        lane_width: Distance between home and passing lane [m].
        corridor: Half width of the strip that must be free for a lane to be free [m].
        flank: Half width of the home lane beside the car, where the flank of a thing may be all
            that is seen of it and a bend makes the lane uncertain [m].
        flank_reach: Distance up to which that counts [m].
        body: Half width of the strip that the car sweeps, with a margin [m].
        max_slope: Steepest lane change, sideways per forward movement.
        sight: Gap in the home lane below which the expert overtakes [m].
        clear: Free home lane that it needs to go back [m].
        beside: Points up to this far behind the bumper still count as beside the car [m].
        hold: Distance driven after the home lane has become free before going back [m].
        max_bend: Curvature beyond which it does not go back: no sensor looks round a hairpin [1/m].
        shift_rate: Speed at which the wanted offset moves across the road [m/s].
        creep_rate: Least of that speed, so that a creeping car turns out sharply [m/s].
        shift_acceleration: At which that speed rises and falls [m/s^2].
        max_lag: Distance to the wanted offset at which it starts again from the car [m].
        settled: Offset to a lane's centre at which a lane change is over [m].
        avoidance_speed: Set-point next to obstacles [m/s].
        max_range: LiDAR reading where nothing was hit [m].
        lateral: Gains of the steering cascade.
        longitudinal: How fast the expert drives.
        crossing: What counts as a pedestrian.
    """

    lane_width: float = 3.5
    corridor: float = 1.45
    flank: float = 1.9
    flank_reach: float = 8.0
    body: float = 1.25
    max_slope: float = 0.35
    sight: float = 30.0
    clear: float = 22.0
    beside: float = 1.0
    hold: float = 3.0
    max_bend: float = 0.045
    shift_rate: float = 1.8
    creep_rate: float = 0.6
    shift_acceleration: float = 1.5
    max_lag: float = 1.5
    settled: float = 0.7
    avoidance_speed: float = 7.0
    max_range: float = 40.0
    lateral: LateralConfig = field(default_factory=LateralConfig)
    longitudinal: LongitudinalConfig = field(default_factory=LongitudinalConfig)
    crossing: CrossingConfig = field(default_factory=CrossingConfig)

    def __post_init__(self) -> None:
        for name in (
            "lane_width",
            "corridor",
            "sight",
            "clear",
            "shift_rate",
            "settled",
            "avoidance_speed",
            "max_range",
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"`{name}` must be positive. Got {getattr(self, name)}.")


@dataclass(frozen=True, slots=True)
class ExpertDecision:
    """What the expert does in a state.

    Attributes:
        setpoint: Where the controllers want to be (2,) [rad, m/s]: the label a* of imitation.
        command: The set-point slew-limited from the last executed command (2,) [rad, m/s]: what
            the expert executes.
        mode: Driving mode.
    """

    setpoint: Array
    command: Array
    mode: Mode


class FSMExpert:
    """Drives from sensor estimates only.

    | mode | offset wanted | leaves when |
    |---|---|---|
    | Lane Following | home | the home lane is blocked and the passing lane is free |
    | Obstacle Avoidance | passing | the car has arrived in the passing lane |
    | Driving Straight | passing | the home lane is free again, the neighbour left behind |
    | Returning | home | the car has arrived, or the home lane is blocked again |

    Args:
        config: Thresholds and gains.
        limits: What the actuators can do.
    """

    def __init__(self, config: ExpertConfig, limits: ActuatorLimits) -> None:
        self._config = config
        self._limits = limits
        self._watch = CrossingWatch(config.crossing, limits.dt)
        self._neighbour = Neighbour(config.clear, config.hold, limits.dt)
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._mode = Mode.LANE_FOLLOWING
        self._reference: float | None = None
        self._rate = 0.0
        self._pace: float | None = None
        self._last_scan: Array | None = None
        self._repeats: NDArray[np.int64] | None = None
        self._watch.reset()
        self._neighbour.reset()

    def act(self, scan: Array, lane: LaneEstimate, speed: float, previous: Array) -> ExpertDecision:
        """Decide for the current state.

        Args:
            scan: LiDAR ranges (beams,) [m].
            lane: Estimated lane pose.
            speed: Measured forward speed [m/s].
            previous: Last executed command (2,) [rad, m/s].
        """
        config, limits = self._config, self._limits
        lanes = LaneMap.build(self._working(scan), lane, config.max_range)
        yaw_rate = speed * math.tan(float(previous[0])) / limits.wheelbase
        people = self._watch.update(lanes, speed, yaw_rate)
        for person in people:
            lanes = lanes.without(person.s, person.d, 0.8)
        home = lanes.gap(0.0, config.corridor, -config.beside)
        flank = lanes.gap(0.0, config.flank, -config.beside)
        home = min(home, flank) if flank < config.flank_reach else home
        passing = lanes.gap(config.lane_width, config.corridor, -config.beside)
        self._neighbour.update(home, speed)
        self._mode = self._next_mode(home, passing, lane, speed)
        target, rate = self._shift(lane.lateral_offset, speed)
        bumper = lane.lateral_offset + LIDAR_FORWARD * math.sin(lane.heading_error)
        gap = min(
            self._gap_ahead(lanes, lane, speed),
            self._gap_to(people, (lane.lateral_offset, bumper, target), speed),
        )
        wanted = min(self._follow_bend(lane), stopping_speed(config.longitudinal, gap))
        if self._mode in (Mode.OBSTACLE_AVOIDANCE, Mode.DRIVING_STRAIGHT):
            wanted = min(wanted, config.avoidance_speed)
        steering = steer(config.lateral, lane, target, rate, speed, float(previous[0]), limits)
        setpoint = np.clip([steering, wanted], limits.low, limits.high)
        return ExpertDecision(setpoint, self.approach(setpoint, previous, 1)[0], self._mode)

    def approach(self, setpoint: Array, previous: Array, horizon: int) -> Array:
        """Commands (horizon, 2) that go from `previous` (2,) to `setpoint` (2,).

        Steering and brakes at full rate, the accelerator at a comfortable one.
        """
        limits = self._limits
        steps = np.arange(1, horizon + 1)[:, None] * limits.dt * _INSIDE
        pull = min(limits.max_acceleration, self._config.longitudinal.acceleration)
        rise = np.array([limits.max_steering_rate, pull])
        fall = np.array([limits.max_steering_rate, limits.max_deceleration])
        return np.clip(setpoint, previous - fall * steps, previous + rise * steps)

    def _next_mode(self, home: float, passing: float, lane: LaneEstimate, speed: float) -> Mode:
        config, mode, offset = self._config, self._mode, lane.lateral_offset
        blocked = home < config.sight
        if mode in (Mode.LANE_FOLLOWING, Mode.RETURNING):
            if blocked and passing > min(home + 8.0, config.sight):
                return Mode.OBSTACLE_AVOIDANCE
            arrived = abs(offset) < config.settled
            return Mode.LANE_FOLLOWING if arrived or mode is Mode.LANE_FOLLOWING else mode
        ends = lane.curvature, lane.curvature + lane.curvature_rate * config.longitudinal.preview
        overseen = min(abs(bend) for bend in ends) < config.max_bend
        if overseen and self._neighbour.passed(speed):
            return Mode.RETURNING
        arrived = abs(offset - config.lane_width) < config.settled
        return Mode.DRIVING_STRAIGHT if arrived else mode

    def _shift(self, offset: float, speed: float) -> tuple[float, float]:
        """Move the wanted offset towards the mode's lane: offset [m] and its rate [m/s].

        The rate rises and falls with `shift_acceleration`: a lane change that passengers like.
        """
        config, dt = self._config, self._limits.dt
        if self._reference is None or abs(self._reference - offset) > config.max_lag:
            self._reference, self._rate = offset, 0.0
        left = self._goal() - self._reference
        brake = math.sqrt(2.0 * config.shift_acceleration * abs(left))
        fastest = min(config.shift_rate, max(config.max_slope * speed, config.creep_rate))
        wanted = math.copysign(min(fastest, brake, abs(left) / dt), left)
        step = config.shift_acceleration * dt
        self._rate += max(-step, min(step, wanted - self._rate))
        self._reference += self._rate * dt
        return self._reference, self._rate

    def _follow_bend(self, lane: LaneEstimate) -> float:
        """Speed for the bends, without the estimate's noise [m/s]."""
        config = self._config.longitudinal
        wanted = bend_speed(config, lane)
        share = min(1.0, self._limits.dt / config.pace_time)
        self._pace = wanted if self._pace is None else self._pace + share * (wanted - self._pace)
        return self._pace

    def _gap_ahead(self, lanes: LaneMap, lane: LaneEstimate, speed: float) -> float:
        """Free distance on the way to the lane that the mode asks for [m]."""
        config = self._config
        slope = min(config.max_slope, config.shift_rate / max(speed, 1.0))
        return lanes.gap_on_the_way(lane.lateral_offset, self._goal(), slope, config.body)

    def _gap_to(self, people: Sequence[Pedestrian], ways: Sequence[float], speed: float) -> float:
        """Free distance to the first pedestrian who is in the way or about to be [m]."""
        config = self._config.crossing
        gaps = [
            person.s - config.standoff
            for person in people
            if any(person.blocks(way, speed, config.room) for way in ways)
        ]
        return max(0.0, min(gaps)) if gaps else math.inf

    def _working(self, scan: Array) -> Array:
        """The scan without beams that have repeated one reading bit by bit: they are stuck."""
        ranges = np.array(scan, dtype=np.float64)
        last, self._last_scan = self._last_scan, ranges.copy()
        if last is None or self._repeats is None or last.shape != ranges.shape:
            self._repeats = np.zeros(ranges.shape, dtype=np.int64)
            return ranges
        self._repeats = np.where(ranges == last, self._repeats + 1, 0)
        ranges[self._repeats >= _STUCK_AFTER] = np.inf
        return ranges

    def _goal(self) -> float:
        passing = self._mode in (Mode.OBSTACLE_AVOIDANCE, Mode.DRIVING_STRAIGHT)
        return self._config.lane_width if passing else 0.0
