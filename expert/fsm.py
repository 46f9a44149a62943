"""The expert: a finite-state machine over four driving modes (paper, Sec. FSM-aware replay)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from expert.crossing import STANDOFF, CrossingWatch, Pedestrian
from expert.lane_map import Array, LaneMap
from expert.lateral import steer
from expert.longitudinal import PREVIEW, LongitudinalConfig, bend_speed, stopping_speed
from expert.modes import Mode
from expert.neighbour import Neighbour
from shield import ActuatorLimits, LaneEstimate, LaneGeometry, ScannerGeometry, VehicleGeometry
from shield.errors import check_positive
from shield.estimation.scan import ScanFilter

CORRIDOR = 1.45  # [m] half width of the strip that must be free for a lane to be free
BESIDE = 1.0  # [m] points up to this far behind the bumper are beside the car
FLANK = 1.9  # [m] half width of the home lane beside the car, where only a flank may be seen
FLANK_REACH = 8.0  # [m] distance up to which that width counts
BODY_MARGIN = 0.35  # [m] on each side of the body in the strip that the car sweeps
PEDESTRIAN_RADIUS = 0.8  # [m] around a pedestrian; points in it are no obstacle to overtake
MIN_ADVANTAGE = 8.0  # [m] by which the passing lane must be free beyond the home lane
MAX_BEND = 0.045  # [1/m] beyond which the car does not go back: no sensor sees round a hairpin
MAX_SLOPE = 0.35  # steepest lane change, sideways per forward movement
MIN_SHIFT_SPEED = 1.0  # [m/s] below which a lane change gets no steeper
CREEP_RATE = 0.6  # [m/s] least speed of the target offset, so that a creeping car turns out sharply
MAX_LAG = 1.5  # [m] distance to the target offset at which the target restarts from the car
SETTLED = 0.7  # [m] offset to a lane's centre at which a lane change is over
PACE_TIME = 0.6  # [s] time constant of the speed for bends: the estimate of a bend is noisy
INSIDE = 1.0 - 1e-9  # of a rate, so that rounding breaks no bound
PASSING_LANE = LaneGeometry().width  # [m] offset of its centre to the left of the home lane's
SCANNER, VEHICLE = ScannerGeometry(), VehicleGeometry()


@dataclass(frozen=True, slots=True)
class ExpertConfig:
    """How the expert changes lanes, and how fast it drives."""

    sight: float = 30.0  # Gap in the home lane below which the expert overtakes [m]
    clear: float = 22.0  # Gap in the home lane from which it goes back [m]
    hold: float = 3.0  # Distance driven after the home lane has become free before going back [m]
    shift_rate: float = 1.8  # Speed at which the target offset moves across the road [m/s]
    shift_acceleration: float = 1.5  # At which that speed rises and falls [m/s^2]
    avoidance_speed: float = 7.0  # Set-point next to obstacles [m/s]
    longitudinal: LongitudinalConfig = field(default_factory=LongitudinalConfig)

    def __post_init__(self) -> None:
        numbers = ("sight", "clear", "hold", "shift_rate", "shift_acceleration", "avoidance_speed")
        check_positive(ValueError, **{name: getattr(self, name) for name in numbers})


@dataclass(frozen=True, slots=True)
class ExpertDecision:
    """What the expert does in a state."""

    setpoint: Array  # Where the controllers want to be (2,) [rad, m/s]: the label a* of imitation
    command: Array  # Slew-limited from the last executed one (2,) [rad, m/s]: what it executes
    mode: Mode  # Driving mode


class FSMExpert:
    """Drives from sensor estimates only.

    | mode | target offset | leaves when |
    |---|---|---|
    | Lane Following | home | the home lane is blocked and the passing lane is free |
    | Obstacle Avoidance | passing | the car has arrived in the passing lane |
    | Driving Straight | passing | the home lane is free again, the neighbour left behind |
    | Returning | home | the car has arrived, or the home lane is blocked again |
    """

    def __init__(
        self,
        config: ExpertConfig,
        limits: ActuatorLimits,
        *,
        scanner: ScannerGeometry = SCANNER,
        vehicle: VehicleGeometry = VEHICLE,
    ) -> None:
        self._config = config
        self._limits = limits
        self._scanner = scanner
        self._body = 0.5 * vehicle.width + BODY_MARGIN
        self._scan_filter = ScanFilter(scanner.max_range)
        self._watch = CrossingWatch(limits.dt, scanner.mount)
        self._neighbour = Neighbour(config.clear, config.hold, limits.dt, vehicle.length)
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._mode = Mode.LANE_FOLLOWING
        self._reference: float | None = None
        self._rate = 0.0
        self._pace: float | None = None
        for part in (self._scan_filter, self._watch, self._neighbour):
            part.reset()

    def act(self, scan: Array, lane: LaneEstimate, speed: float, previous: Array) -> ExpertDecision:
        """Decide by a scan (beams,) [m], the `speed` [m/s] and the last command (2,) [rad, m/s].

        While the scan is unusable (too few beams work, or none changes) the expert drives at
        `blind_speed`. `ValueError` for a scan of another number of beams than the scanner's.
        """
        beams = self._scanner.beams
        if np.shape(scan) != (beams,):
            raise ValueError(f"`scan` must have shape ({beams},). Got {np.shape(scan)}.")
        clean = self._scan_filter.examine(scan, speed)
        lanes = LaneMap.build(clean.ranges, lane, self._scanner)
        yaw_rate = speed * math.tan(float(previous[0])) / self._limits.wheelbase
        people = self._watch.update(lanes, speed, yaw_rate)
        for person in people:
            lanes = lanes.without(person.s, person.d, PEDESTRIAN_RADIUS)
        self._mode = self._next_mode(lanes, lane, speed)
        reference = self._shift(lane.lateral_offset, speed)
        fastest = min(self._follow_bend(lane), self._stop(lanes, lane, people, reference[0], speed))
        if self._mode in (Mode.OBSTACLE_AVOIDANCE, Mode.DRIVING_STRAIGHT):
            fastest = min(fastest, self._config.avoidance_speed)
        if not clean.usable:
            fastest = min(fastest, self._config.longitudinal.blind_speed)
        steering = steer(lane, reference, speed, float(previous[0]), self._limits)
        setpoint = np.clip([steering, fastest], self._limits.low, self._limits.high)
        return ExpertDecision(setpoint, self.approach(setpoint, previous, 1)[0], self._mode)

    def approach(self, setpoint: Array, previous: Array, horizon: int) -> Array:
        """Commands (horizon, 2) that go from `previous` (2,) to `setpoint` (2,).

        Steering and brakes at full rate, the accelerator at a comfortable one.
        """
        limits = self._limits
        steps = np.arange(1, horizon + 1)[:, None] * limits.dt * INSIDE
        pull = min(limits.max_acceleration, self._config.longitudinal.acceleration)
        rise = np.array([limits.max_steering_rate, pull])
        fall = np.array([limits.max_steering_rate, limits.max_deceleration])
        return np.clip(setpoint, previous - fall * steps, previous + rise * steps)

    def _next_mode(self, lanes: LaneMap, lane: LaneEstimate, speed: float) -> Mode:
        """The next mode, by the free distances in the two lanes."""
        home = lanes.gap(0.0, CORRIDOR, -BESIDE)
        flank = lanes.gap(0.0, FLANK, -BESIDE)
        home = min(home, flank) if flank < FLANK_REACH else home
        passing = lanes.gap(PASSING_LANE, CORRIDOR, -BESIDE)
        self._neighbour.update(home, speed)
        mode, offset, sight = self._mode, lane.lateral_offset, self._config.sight
        if mode in (Mode.LANE_FOLLOWING, Mode.RETURNING):
            if home < sight and passing > min(home + MIN_ADVANTAGE, sight):
                return Mode.OBSTACLE_AVOIDANCE
            arrived = abs(offset) < SETTLED
            return Mode.LANE_FOLLOWING if arrived or mode is Mode.LANE_FOLLOWING else mode
        ends = lane.curvature, lane.curvature + lane.curvature_rate * PREVIEW
        overseen = min(abs(bend) for bend in ends) < MAX_BEND
        if overseen and self._neighbour.passed(speed):
            return Mode.RETURNING
        arrived = abs(offset - PASSING_LANE) < SETTLED
        return Mode.DRIVING_STRAIGHT if arrived else mode

    def _shift(self, offset: float, speed: float) -> tuple[float, float, float]:
        """Move the target offset comfortably towards the mode's lane, with its two derivatives."""
        config, dt = self._config, self._limits.dt
        if self._reference is None or abs(self._reference - offset) > MAX_LAG:
            self._reference, self._rate = offset, 0.0
        left = self._goal() - self._reference
        brake = math.sqrt(2.0 * config.shift_acceleration * abs(left))
        fastest = min(config.shift_rate, max(MAX_SLOPE * speed, CREEP_RATE))
        target = math.copysign(min(fastest, brake, abs(left) / dt), left)
        step = config.shift_acceleration * dt
        change = max(-step, min(step, target - self._rate))
        self._rate += change
        self._reference += self._rate * dt
        return self._reference, self._rate, change / dt

    def _follow_bend(self, lane: LaneEstimate) -> float:
        """Speed for the bends, without the estimate's noise [m/s]."""
        target = bend_speed(self._config.longitudinal, lane)
        share = min(1.0, self._limits.dt / PACE_TIME)
        self._pace = target if self._pace is None else self._pace + share * (target - self._pace)
        return self._pace

    def _stop(
        self,
        lanes: LaneMap,
        lane: LaneEstimate,
        people: Sequence[Pedestrian],
        target: float,
        speed: float,
    ) -> float:
        """Speed from which the car stops before obstacles and pedestrians in its path [m/s]."""
        offset = lane.lateral_offset
        slope = min(MAX_SLOPE, self._config.shift_rate / max(speed, MIN_SHIFT_SPEED))
        gap = lanes.gap_on_the_way(offset, self._goal(), slope, self._body)
        bumper = offset + self._scanner.mount * math.sin(lane.heading_error)
        for person in people:
            if any(person.blocks(path, speed) for path in (offset, bumper, target)):
                gap = min(gap, max(0.0, person.s - STANDOFF))
        return stopping_speed(self._config.longitudinal, gap)

    def _goal(self) -> float:
        """Offset of the mode's lane [m]."""
        passing = self._mode in (Mode.OBSTACLE_AVOIDANCE, Mode.DRIVING_STRAIGHT)
        return PASSING_LANE if passing else 0.0
