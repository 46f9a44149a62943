"""The expert: a finite-state machine over four driving modes (paper, Sec. FSM-aware replay)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from expert.crossing import STANDOFF, CrossingWatch, Pedestrian
from expert.lane_map import Array, LaneMap
from expert.lateral import SHIFT_RATE, steer
from expert.longitudinal import PREVIEW, LongitudinalConfig, bend_speed, stopping_speed
from expert.modes import Mode
from shield import ActuatorLimits, LaneEstimate, LaneGeometry, World
from shield.errors import check_positive

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
SETTLED = 0.7  # [m] offset to a lane's centre at which a lane change is over
PASSING_LANE = LaneGeometry().width  # [m] offset of its centre to the left of the home lane's
MARGIN = 1.0  # [m] behind the rear bumper when the two lanes begin to overlap
CHANGE_TIME = 0.7  # [s] from the beginning of a lane change until the lanes overlap


@dataclass(frozen=True, slots=True)
class ExpertConfig:
    """How the expert changes lanes, and how fast it drives."""

    sight: float = 30.0  # Gap in the home lane below which it overtakes, else goes back [m]
    hold: float = 3.0  # Distance driven after the home lane has become free before going back [m]
    avoidance_speed: float = 7.0  # Set-point next to obstacles [m/s]
    longitudinal: LongitudinalConfig = field(default_factory=LongitudinalConfig)

    def __post_init__(self) -> None:
        sizes = {"sight": self.sight, "hold": self.hold}
        check_positive(ValueError, **sizes, avoidance_speed=self.avoidance_speed)


@dataclass(frozen=True, slots=True)
class ExpertDecision:
    """What the expert does in a state."""

    setpoint: Array  # Steering and speed that it asks for (2,) [rad, m/s]: the label of imitation
    mode: Mode  # Driving mode


class FSMExpert:
    """Drives from what a world knows by its sensors.

    | mode | target offset | leaves when |
    |---|---|---|
    | Lane Following | home | the home lane is blocked and the passing lane is free |
    | Obstacle Avoidance | passing | the car has arrived in the passing lane |
    | Driving Straight | passing | the home lane is free again, the neighbour left behind |
    | Returning | home | the car has arrived, or the home lane is blocked again |
    """

    def __init__(self, config: ExpertConfig, limits: ActuatorLimits) -> None:
        self._config = config
        self._limits = limits
        self._watch = CrossingWatch()
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._mode = Mode.LANE_FOLLOWING
        self._free_for = 0.0  # [m] driven since the home lane became free
        self._watch.reset()

    def act(self, world: World, lane: LaneEstimate, previous: Array) -> ExpertDecision:
        """Decide by a world after its update, and the last command (2,) [rad, m/s].

        While the scan is unusable (too few beams work, or none changes) the expert drives at
        `blind_speed`.
        """
        speed = world.speed
        lanes = LaneMap.build(world.clean.ranges, lane, world.scanner)
        people = self._watch.update(lanes, world.tracks)
        passing = lanes.gap(PASSING_LANE, CORRIDOR, -BESIDE)
        for person in people:  # are waited for, not overtaken
            lanes = lanes.without(person.s, person.d, PEDESTRIAN_RADIUS)
        self._mode = self._next_mode(world, lanes, passing)
        pace = bend_speed(self._config.longitudinal, lane)
        fastest = min(pace, self._stop(world, lanes, people))
        if self._mode in (Mode.OBSTACLE_AVOIDANCE, Mode.DRIVING_STRAIGHT):
            fastest = min(fastest, self._config.avoidance_speed)
        if not world.clean.usable:
            fastest = min(fastest, self._config.longitudinal.blind_speed)
        steering = steer(lane, self._goal(), speed, float(previous[0]), self._limits)
        setpoint = np.clip([steering, fastest], self._limits.low, self._limits.high)
        return ExpertDecision(setpoint, self._mode)

    def _next_mode(self, world: World, lanes: LaneMap, passing: float) -> Mode:
        """The next mode, by the free distances in the home lane and in the passing lane [m]."""
        home = lanes.gap(0.0, CORRIDOR, -BESIDE)
        flank = lanes.gap(0.0, FLANK, -BESIDE)
        home = min(home, flank) if flank < FLANK_REACH else home
        lane, mode, sight = lanes.lane, self._mode, self._config.sight
        offset, driven = lane.lateral_offset, world.speed * self._limits.dt
        self._free_for = 0.0 if home < sight else self._free_for + driven
        if mode in (Mode.LANE_FOLLOWING, Mode.RETURNING):
            if home < sight and passing > min(home + MIN_ADVANTAGE, sight):
                return Mode.OBSTACLE_AVOIDANCE
            arrived = abs(offset) < SETTLED
            return Mode.LANE_FOLLOWING if arrived or mode is Mode.LANE_FOLLOWING else mode
        ends = lane.curvature, lane.curvature + lane.curvature_rate * PREVIEW
        overseen = min(abs(bend) for bend in ends) < MAX_BEND
        if overseen and self._free_for > self._config.hold and not _beside(world, lane):
            return Mode.RETURNING
        arrived = abs(offset - PASSING_LANE) < SETTLED
        return Mode.DRIVING_STRAIGHT if arrived else mode

    def _stop(self, world: World, lanes: LaneMap, people: Sequence[Pedestrian]) -> float:
        """Speed from which the car stops before obstacles and pedestrians in its path [m/s]."""
        offset, goal, speed = lanes.lane.lateral_offset, self._goal(), world.speed
        slope = min(MAX_SLOPE, SHIFT_RATE / max(speed, MIN_SHIFT_SPEED))
        body = 0.5 * world.vehicle.width + BODY_MARGIN
        gap = lanes.gap_on_the_way(offset, goal, slope, body)
        bumper = offset + lanes.mount * math.sin(lanes.lane.heading_error)
        for person in people:
            if any(person.blocks(path, speed) for path in (offset, bumper, goal)):
                gap = min(gap, max(0.0, person.s - STANDOFF))
        return stopping_speed(self._config.longitudinal, gap)

    def _goal(self) -> float:
        """Offset of the mode's lane [m]."""
        passing = self._mode in (Mode.OBSTACLE_AVOIDANCE, Mode.DRIVING_STRAIGHT)
        return PASSING_LANE if passing else 0.0


def _beside(world: World, lane: LaneEstimate) -> bool:
    """Whether anything seen or remembered will be beside the car when it is in the home lane."""
    known = world.obstacles
    places = LaneMap.place(known.points, lane, world.scanner.mount)
    lost = CHANGE_TIME * np.maximum(world.speed - known.velocity[:, 0], 0.0)
    beside = (places.s < 0.0) & (places.s - lost > -world.vehicle.length - MARGIN)
    return bool((beside & (np.abs(places.d) < FLANK)).any())
