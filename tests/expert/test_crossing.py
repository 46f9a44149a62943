"""Pedestrians are told from barrels and cars, and the expert lets them cross."""

import numpy as np
import pytest

from expert import ExpertConfig, FSMExpert, Mode
from expert.crossing import CrossingConfig, CrossingWatch, Pedestrian
from expert.lane_map import LaneMap
from shield import ActuatorLimits, LaneEstimate

LANE = LaneEstimate(0.0, 0.0, 0.0, 0.0, 0.05, 0.0, valid=True)
ANGLES = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 180)


def scan_of(x: float, y: float, width: float) -> np.ndarray:
    """A flat thing `width` wide, facing the LiDAR at (x, y) from the bumper."""
    scan = np.full(180, 40.0)
    across = x * np.tan(ANGLES[1:-1])
    hit = np.flatnonzero(np.abs(across - y) < 0.5 * width) + 1
    scan[hit] = x / np.cos(ANGLES[hit])
    return scan


def watch(x: float, ys: np.ndarray, width: float) -> list[Pedestrian]:
    """What is seen of a thing that moves sideways while the car stands."""
    found: list[Pedestrian] = []
    watcher = CrossingWatch(CrossingConfig(), 0.1)
    for y in ys:
        found = watcher.update(LaneMap.build(scan_of(x, y, width), LANE, 40.0), 0.0, 0.0)
    return found


def test_a_walker_is_seen_and_his_direction_too() -> None:
    """From the right to the left through the home lane."""
    people = watch(14.0, np.linspace(-1.6, 0.2, 16), 0.5)
    assert len(people) == 1
    assert people[0].way == 1.0
    assert people[0].s == pytest.approx(14.0, abs=0.3)
    assert people[0].d == pytest.approx(0.2, abs=0.3)


def test_a_barrel_and_a_car_are_no_pedestrians() -> None:
    """Narrow and still in the lane, or wide: nobody crosses."""
    assert watch(14.0, np.full(16, 0.3), 0.7) == []
    assert watch(14.0, np.linspace(-1.6, 0.2, 16), 1.8) == []


@pytest.mark.parametrize(
    ("d", "way", "blocks"),
    [(-1.5, 1.0, True), (0.5, 1.0, True), (2.5, 1.0, False), (2.0, -1.0, True)],
)
def test_who_blocks_the_home_lane(d: float, way: float, blocks: bool) -> None:
    """Everybody who is on it or about to be; nobody who has left it."""
    assert Pedestrian(12.0, d, way).blocks(0.0, 6.0, 1.9) is blocks


def test_the_car_passes_before_a_far_walker() -> None:
    """Beside the bumper and four metres away he is too late to matter."""
    assert not Pedestrian(0.5, -2.4, 1.0).blocks(3.5, 0.0, 1.9)


def test_the_expert_stops_and_does_not_swerve() -> None:
    """In front of a walker it brakes in its lane instead of overtaking him."""
    expert = FSMExpert(ExpertConfig(), ActuatorLimits())
    speeds = []
    for k in range(20):
        scan = scan_of(16.0 - 0.5 * k, -1.8 + 0.12 * k, 0.5)
        decision = expert.act(scan, LANE, 5.0, np.array([0.0, 5.0]))
        assert decision.mode is Mode.LANE_FOLLOWING
        assert abs(decision.setpoint[0]) < 0.02
        speeds.append(decision.setpoint[1])
    assert speeds[-1] < 2.5 < speeds[5]


def test_stuck_beams_are_left_out() -> None:
    """A beam that repeats itself bit by bit in front of the car stops nobody for long."""
    expert = FSMExpert(ExpertConfig(), ActuatorLimits())
    scan = np.full(180, 40.0)
    scan[60:120] = 8.0
    decisions = [expert.act(scan, LANE, 5.0, np.array([0.0, 5.0])) for _ in range(8)]
    assert decisions[0].setpoint[1] < 6.0
    assert decisions[-1].setpoint[1] > 8.0


def test_nonsense_is_refused() -> None:
    """The error names the field and the value."""
    with pytest.raises(ValueError, match="`width` must be positive. Got 0.0"):
        CrossingConfig(width=0.0)
