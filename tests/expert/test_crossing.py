"""Pedestrians are told from barrels and cars, and the expert lets them cross."""

from dataclasses import replace

import numpy as np
import pytest

from expert import ExpertConfig, ExpertDecision, FSMExpert, Mode
from expert.crossing import CrossingWatch, Pedestrian
from expert.lane_map import LaneMap
from shield import (
    ActuatorLimits,
    LaneEstimate,
    LaneGeometry,
    ScannerGeometry,
    VehicleGeometry,
    World,
)

LANE = LaneEstimate(0.0, 0.0, 0.0, 0.0, 0.05, 0.0, valid=True)
SCANNER = ScannerGeometry()
ANGLES = SCANNER.angles


def new_world(scanner: ScannerGeometry = SCANNER) -> World:
    """A world that has seen nothing yet."""
    return World(0.1, scanner, VehicleGeometry(), LaneGeometry())


class Seeing:
    """An expert, and the world that it sees."""

    def __init__(self, scanner: ScannerGeometry = SCANNER) -> None:
        self.world, self.expert = new_world(scanner), FSMExpert(ExpertConfig(), ActuatorLimits())

    def act(
        self, scan: np.ndarray, lane: LaneEstimate = LANE, speed: float = 5.0
    ) -> ExpertDecision:
        """What it does after a scan, going straight on."""
        self.world.update(scan, speed, 0.0, lane)
        return self.expert.act(self.world, lane, np.array([0.0, speed]))


def scan_of(x: float, y: float, width: float) -> np.ndarray:
    """A flat thing `width` wide, facing the LiDAR at (x, y) from the bumper."""
    scan = np.full(180, 40.0)
    across = x * np.tan(ANGLES[1:-1])
    hit = np.flatnonzero(np.abs(across - y) < 0.5 * width) + 1
    scan[hit] = x / np.cos(ANGLES[hit])
    return scan


def watch(x: float, ys: np.ndarray, width: float) -> list[Pedestrian]:
    """What is seen of a thing that moves sideways while the car stands."""
    people: list[Pedestrian] = []
    world, watcher = new_world(), CrossingWatch()
    for y in ys:
        people = look(world, watcher, scan_of(x, y, width))
    return people


def look(
    world: World, watcher: CrossingWatch, scan: np.ndarray, lane: LaneEstimate = LANE
) -> list[Pedestrian]:
    """The pedestrians in a scan of a car that stands."""
    world.update(scan, 0.0, 0.0, lane)
    return watcher.update(LaneMap.build(world.clean.ranges, lane, SCANNER), world.tracks)


def test_a_pedestrian_and_its_direction_are_seen() -> None:
    """From the right to the left through the home lane."""
    people = watch(14.0, np.linspace(-1.6, 0.2, 16), 0.5)
    assert len(people) == 1
    assert people[0].direction == 1.0
    assert people[0].s == pytest.approx(14.0, abs=0.3)
    assert people[0].d == pytest.approx(0.2, abs=0.3)


def test_a_barrel_and_a_car_are_no_pedestrians() -> None:
    """Narrow and still in the lane, or wide: no pedestrian."""
    assert watch(14.0, np.full(16, 0.3), 0.7) == []
    assert watch(14.0, np.linspace(-1.6, 0.2, 16), 1.8) == []


@pytest.mark.parametrize(
    ("d", "direction", "blocks"),
    [(-1.5, 1.0, True), (0.5, 1.0, True), (2.5, 1.0, False), (2.0, -1.0, True)],
)
def test_which_pedestrians_block_the_home_lane(d: float, direction: float, blocks: bool) -> None:
    """Those on it and about to be, not those who have left it."""
    assert Pedestrian(12.0, d, direction).blocks(0.0, 6.0) is blocks


def test_the_car_passes_before_a_far_pedestrian() -> None:
    """Beside the bumper and four metres away a pedestrian arrives too late to matter."""
    assert not Pedestrian(0.5, -2.4, 1.0).blocks(3.5, 0.0)


def test_the_expert_stops_and_does_not_swerve() -> None:
    """In front of a pedestrian it brakes in its lane instead of overtaking."""
    expert = Seeing()
    speeds = []
    for k in range(20):
        scan = scan_of(16.0 - 0.5 * k, -1.8 + 0.12 * k, 0.5)
        decision = expert.act(scan)
        assert decision.mode is Mode.LANE_FOLLOWING
        assert abs(decision.setpoint[0]) < 0.02
        speeds.append(decision.setpoint[1])
    assert speeds[-1] < 2.5 < speeds[5]


@pytest.mark.parametrize(("rear", "people"), [(True, 0), (False, 1)])
def test_a_single_hit_on_a_flank_is_no_pedestrian(rear: bool, people: int) -> None:
    """Behind the rear of a car it is its flank; alone, where no barrel stands, a pedestrian."""
    world, watcher = new_world(), CrossingWatch()
    passing = replace(LANE, lateral_offset=3.4)
    scan = scan_of(8.0, -3.1, 1.8) if rear else np.full(180, 40.0)
    beam = int(np.argmin(np.abs(ANGLES - np.arctan2(-2.0, 11.0))))
    scan[beam] = np.hypot(2.0, 11.0)
    for _ in range(6):
        seen = look(world, watcher, scan, passing)
    assert len(seen) == people


@pytest.mark.parametrize(
    ("person", "mode"), [(True, Mode.LANE_FOLLOWING), (False, Mode.OBSTACLE_AVOIDANCE)]
)
def test_a_lane_with_a_pedestrian_in_it_is_not_free(person: bool, mode: Mode) -> None:
    """The expert stays behind."""
    expert, rng = Seeing(), np.random.default_rng(0)
    scan = scan_of(25.0, 0.0, 1.8)
    if person:
        scan = np.minimum(scan, scan_of(10.0, 3.3, 0.6))
    for _ in range(8):
        noisy = np.where(scan < 40.0, scan + 0.02 * rng.normal(size=180), scan)
        decision = expert.act(noisy)
    assert decision.mode is mode


def test_what_is_overtaken_is_not_gone_back_to() -> None:
    """One gap decides about both, so that the mode does not go to and fro."""
    expert, rng, modes = Seeing(), np.random.default_rng(0), []
    for step in range(20):
        scan = scan_of(26.0, -3.5 if step else 0.0, 1.8)
        noisy = np.where(scan < 40.0, scan + 0.02 * rng.normal(size=180), scan)
        lane = replace(LANE, lateral_offset=3.5 if step else 0.0)
        modes.append(expert.act(noisy, lane).mode)
    assert modes == [Mode.OBSTACLE_AVOIDANCE] + [Mode.DRIVING_STRAIGHT] * 19


def test_judgements_of_lost_tracks_are_forgotten() -> None:
    """However many things pass, what is remembered is bounded."""
    world, watcher = new_world(), CrossingWatch()
    rng = np.random.default_rng(0)
    for _ in range(200):
        scan = scan_of(float(rng.uniform(6.0, 20.0)), float(rng.uniform(-1.0, 4.0)), 0.6)
        look(world, watcher, scan)
    assert len(watcher._judgements) < 20


def changing_scan(rng: np.random.Generator) -> np.ndarray:
    """A wall far to the left, with a reading's noise, and nothing ahead."""
    scan = np.full(180, 40.0)
    scan[150:] = 12.0 + 0.03 * rng.normal(size=30)
    return scan


def test_a_stuck_beam_is_left_out() -> None:
    """A beam that repeats itself bit by bit while the scene changes stops nobody for long."""
    expert, rng = Seeing(), np.random.default_rng(0)
    speeds = []
    for _ in range(20):
        scan = changing_scan(rng)
        scan[90] = 2.5
        decision = expert.act(scan)
        speeds.append(float(decision.setpoint[1]))
    assert speeds[0] < 3.0
    assert speeds[-1] > 6.5


def test_a_car_ahead_at_a_standstill_is_no_stuck_beam() -> None:
    """Waiting behind a standing car with a noise-free scanner, the expert goes on waiting."""
    expert = Seeing()
    scan = np.minimum(scan_of(2.0, 0.0, 8.0), scan_of(3.0, 3.5, 3.0))
    decisions = [expert.act(scan, speed=0.0) for _ in range(20)]
    assert max(float(decision.setpoint[1]) for decision in decisions) < 1.0


@pytest.mark.parametrize("kind", ["nan", "frozen", "half dead"])
def test_an_unusable_scan_slows_the_expert_down(kind: str) -> None:
    """Without a scanner the expert drives at its blind speed, not at cruise speed."""
    expert, rng = Seeing(), np.random.default_rng(0)
    frozen = changing_scan(rng)
    for _ in range(10):
        scan = frozen.copy() if kind == "frozen" else changing_scan(rng)
        if kind != "frozen":
            scan[: 180 if kind == "nan" else 95] = np.nan
        decision = expert.act(scan)
    assert decision.setpoint[1] == ExpertConfig().longitudinal.blind_speed


def test_a_scanner_of_another_size_is_welcome() -> None:
    """The world says where its beams point."""
    expert = Seeing(ScannerGeometry(beams=90, max_range=20.0))
    decision = expert.act(np.full(90, 20.0))
    assert decision.setpoint[1] == ExpertConfig().longitudinal.cruise_speed
