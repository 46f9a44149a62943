"""A scan that cannot be trusted brings the car to rest; not knowing never makes it faster."""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from shield import ScannerGeometry
from tests.shield.predictive.bodies import Array, Chase, Thing
from tests.shield.predictive.filters import shared_filter
from tests.shield.predictive.kinematic_world import (
    Defect,
    KinematicWorld,
    Record,
    constant,
    drive,
)
from tests.shield.predictive.scenes import LIMITS

BEARINGS = ScannerGeometry().angles
AHEAD = np.abs(BEARINGS) < 0.3
FREE = np.full(180, 40.0)
SILENT = np.full(180, np.nan)
SLOW = pytest.mark.slow


def half_dead(scan: Array) -> Array:
    """51 % dead beams, ten of those that see the wall among the working ones."""
    dead, order = scan.copy(), np.argsort(np.abs(BEARINGS))
    dead[order[10:102]] = np.nan
    return dead


DEFECTS: dict[str, Callable[[Array, Array, int], Array]] = {
    "nan": lambda scan, last, step: SILENT,
    "minus infinity": lambda scan, last, step: np.full(180, -np.inf),
    "zero": lambda scan, last, step: np.zeros(180),
    "negative": lambda scan, last, step: np.full(180, -1.0),
    "infinity after a wall": lambda scan, last, step: np.full(180, np.inf),
    "maximum after a wall": lambda scan, last, step: FREE,
    "integers": lambda scan, last, step: np.zeros(180, np.int32),
    "frozen": lambda scan, last, step: last,
    "nan ahead": lambda scan, last, step: np.where(AHEAD, np.nan, scan),
    "zero ahead": lambda scan, last, step: np.where(AHEAD, 0.0, scan),
    "frozen ahead": lambda scan, last, step: np.where(AHEAD, last, scan),
    "51 % dead": lambda scan, last, step: half_dead(scan),
    "every other scan dead": lambda scan, last, step: scan if step % 2 else SILENT,
    "frozen and dead in turn": lambda scan, last, step: last if step % 2 else SILENT,
}


def from_step(begin: int, change: Callable[[Array, Array, int], Array]) -> Defect:
    """A defect that begins at a step; it is told the last healthy scan."""
    last = [FREE]

    def defect(scan: Array, step: int) -> Array:
        if step < begin:
            last[0] = scan
            return scan
        return change(scan, last[0], step)

    return defect


def towards_a_wall(
    defect: Defect | None, distance: float = 30.0, speed: float = 8.0, steps: int = 70
) -> Record:
    """Straight on towards a wall across both lanes."""
    wall = Thing(3.6 + distance + 0.5, 1.75, 12.0, 1.0)
    world = KinematicWorld([wall], speed=speed, rng=np.random.default_rng(0))
    return drive(world, shared_filter(), constant(0.0, 8.0), steps, defect)


ALIKE = ["minus infinity", "zero", "negative", "integers", "zero ahead", "maximum after a wall"]
LOST = ["nan", "minus infinity", "zero", "negative", "integers", "frozen"]
PACE = 1.0  # [m/s] of a car that looks for a way around what it sees, or remembers
LONG = 88  # periods: a car that has looked for a way around the wall is at rest after 73


@lru_cache(maxsize=1)
def with_a_scanner_that_works() -> Record:
    """The same drive without a defect."""
    return towards_a_wall(None)


def way(record: Record) -> float:
    """Driven in the first seven seconds [m]."""
    return sum(record.speeds[:70]) * LIMITS.dt


# What begins late is driven with each kind of defect; which values stand for it is seen early.
EARLY_AND_LATE = [(name, 2) for name in DEFECTS] + [
    pytest.param(name, 25, marks=SLOW if name in ALIKE else ()) for name in DEFECTS
]


@pytest.mark.parametrize(("name", "healthy"), EARLY_AND_LATE)
def test_the_car_stops_before_the_wall(name: str, healthy: int) -> None:
    """Whatever the defect, and from wherever it begins; a blind car does not creep on either.

    In seven seconds it gets no further than with a scanner that works, but for the last half metre
    at walking pace.
    """
    record = towards_a_wall(from_step(healthy, DEFECTS[name]), steps=LONG)
    assert record.events == [] and record.distance < 30.0
    assert way(record) <= way(with_a_scanner_that_works()) + 0.5
    assert max(record.speeds[-15:]) <= (0.0 if name in LOST else PACE)


@pytest.mark.parametrize("name", ["nan", "zero", "nan ahead", "zero ahead"])
def test_a_scanner_that_fails_on_a_free_road_brings_the_car_to_rest(name: str) -> None:
    """There is nothing to remember: unknown space comes nearer until the car stands."""
    record = towards_a_wall(from_step(10, DEFECTS[name]), distance=1e3)
    assert record.speeds[-1] == 0.0 and record.distance < 48.0


@pytest.mark.parametrize("name", ["nan", "zero", "nan ahead", "minus infinity"])
@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_scanner_that_never_worked_stops_the_car_at_once(name: str, speed: float) -> None:
    """A car at rest stays there; a moving one brakes as hard as it can."""
    record = towards_a_wall(from_step(0, DEFECTS[name]), speed=speed, steps=30)
    brake = np.maximum(speed - 0.6 * np.arange(1, 31), 0.0)
    assert record.speeds == pytest.approx(brake, abs=1e-6)


def test_before_the_first_scan_the_car_stands() -> None:
    """Whatever is wished: nothing is known."""
    shield = shared_filter()
    for steering in (0.0, 0.25, -0.5):
        shield.reset()
        for _ in range(30):
            assert shield.filter([steering, 8.0]).safe_action[1] == 0.0


@pytest.mark.parametrize(
    "steering", [-0.5, 0.3, *(pytest.param(more, marks=SLOW) for more in (-0.2, 0.0, 0.5))]
)
def test_the_blind_car_stands_whatever_it_steers(steering: float) -> None:
    """And however long: neither the sharpest turn nor the detour gets it going."""
    world = KinematicWorld([], speed=8.0)
    defect = from_step(1, DEFECTS["nan"])
    record = drive(world, shared_filter(), constant(steering, 8.0), 160, defect)
    assert record.events == [] and not any(record.speeds[-100:])


def test_three_missing_scans_do_not_brake() -> None:
    """What was free a moment ago still is."""
    world = KinematicWorld([], speed=11.0)
    dead = from_step(10, lambda scan, last, step: SILENT if step < 13 else scan)
    record = drive(world, shared_filter(), constant(0.0, 11.0), 30, dead)
    assert record.speeds == pytest.approx([11.0] * 30) and not any(record.reasons)


def test_a_scanner_that_comes_back_frees_the_car() -> None:
    """After seven silent seconds it drives on."""
    away = from_step(5, lambda scan, last, step: SILENT if step < 75 else scan)
    record = towards_a_wall(away, distance=80.0, speed=4.0, steps=110)
    assert record.speeds[70] == 0.0 and record.speeds[-1] > 3.0


@pytest.mark.parametrize("wall", [15.0, 1e3])
def test_a_repeated_scan_is_no_defect_where_nothing_moves(wall: float) -> None:
    """A standing car without noise sees the same scan for ever, and an empty road has no ranges."""
    world = KinematicWorld([Thing(3.6 + wall, 1.75, 12.0, 1.0)])
    waits = lambda world, step: np.array([0.0, 8.0 if step > 40 else 0.0])  # noqa: E731
    record = drive(world, shared_filter(), waits, 70)
    assert max(record.speeds[41:]) > 2.5 and record.faults == []


@pytest.mark.parametrize(
    ("dead", "free"),
    [
        pytest.param(
            np.abs(BEARINGS) > 1.52,
            True,
            marks=pytest.mark.xfail(
                strict=True, reason="unknown space beside the scanner comes into the body"
            ),
        ),
        (np.arange(180) % 3 == 0, True),
        (np.abs(np.arange(180) - 90) <= 4, False),
    ],
)
def test_single_dead_beams_do_not_stop_the_car(dead: Array, free: bool) -> None:
    """Nor do the outermost; nine in a row ahead do."""
    world = KinematicWorld([], speed=8.0)
    defect = from_step(0, lambda scan, last, step: np.where(dead, np.nan, scan))
    record = drive(world, shared_filter(), constant(0.0, 8.0), 80, defect)
    assert (record.speeds[-1] > 7.9) == free
    assert free or record.speeds[-1] == 0.0


@pytest.mark.xfail(strict=True, reason="nothing else returns, so they are remembered for ever")
def test_scattered_stuck_beams_on_an_empty_road_do_not_stop_the_car() -> None:
    """They are all that returns, and they repeat; a few of them are no frozen scanner."""
    stuck = FREE.copy()
    stuck[10::20] = np.random.default_rng(0).uniform(2.0, 39.0, 9)
    world = KinematicWorld([], speed=8.0)
    begin = from_step(5, lambda *_: stuck)
    record = drive(world, shared_filter(), constant(0.0, 8.0), 60, begin)
    assert record.speeds[-1] > 7.0 and record.events == []


@pytest.mark.parametrize(
    "beams", [45, 1080, *(pytest.param(more, marks=SLOW) for more in (90, 360))]
)
def test_a_dropout_does_not_hide_a_post(beams: int) -> None:
    """Every third beam gives nothing or the maximum, in turn; the car touches nothing."""
    for missing in (np.nan, 40.0):
        world = KinematicWorld([Thing(25.0, 0.3, 1.2)], speed=6.0)
        world.scanner = ScannerGeometry(beams)
        holes = np.arange(beams)
        drop = lambda scan, step: np.where((holes + step) % 3 == 0, missing, scan)  # noqa: B023, E731
        record = drive(world, shared_filter(beams), constant(0.0, 8.0), 80, drop)
        assert record.faults == []


def test_people_are_remembered_while_the_scanner_is_silent() -> None:
    """A person who walks at the car is not met while five scans of six are lost."""
    for lateral in (4.0, -3.0):
        person = Thing(22.0, lateral, 0.5, motion=Chase())
        world = KinematicWorld([person], speed=6.0)
        lost = from_step(6, lambda scan, last, step: scan if step % 6 == 0 else SILENT)
        record = drive(world, shared_filter(), constant(0.0, 8.0), 80, lost)
        assert record.faults == [], math.hypot(person.x, person.y)


def test_values_that_are_not_finite_count_as_the_last_known_ones() -> None:
    """A lost speed or yaw rate changes nothing on a straight road."""
    shield, world = shared_filter(), KinematicWorld([], speed=8.0)
    shield.reset([0.0, 8.0])
    for step in range(10):
        lost = math.nan if step % 2 else 8.0
        shield.update(world.scan(), lost, lost - 8.0, world.lane())
        assert shield.filter([0.0, 8.0]).safe_action.tolist() == [0.0, 8.0]
        assert shield.world.speed == 8.0


def test_a_lost_lane_brings_the_car_to_rest() -> None:
    """As fast as the committed backup says, on the road."""
    shield, world = shared_filter(), KinematicWorld([], speed=8.0)
    shield.reset([0.0, 8.0])
    for step in range(40):
        shield.update(world.scan(), world.speed, 0.0, world.lane() if step < 5 else None)
        certificate = shield.filter([0.0, 8.0])
        world.advance(certificate.safe_action, step)
        assert step < 5 or "lane is lost" in certificate.reason
    assert world.speed == 0.0 and "lane lost" in shield.world.flags
    assert world.outside() < 0.0
