"""A scan that cannot be trusted bounds the speed; not knowing never enlarges a bound."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from shield import ActuatorLimits, BarrierConfig, ObstacleBarrier, SafetyFilter, ScannerGeometry

LIMITS = ActuatorLimits()
SCANNER = ScannerGeometry()
BEARINGS = SCANNER.angles
FREE = np.full(180, SCANNER.max_range)
AHEAD = np.abs(BEARINGS) < 0.3

Array = np.ndarray
Defect = Callable[[Array, Array, int], Array]


def wall(distance: float) -> Array:
    """Ranges (180,) of a wall 6 m wide across the road."""
    ahead = distance / np.maximum(np.cos(BEARINGS), 1e-9)
    return np.where(np.abs(ahead * np.sin(BEARINGS)) < 3.0, ahead, 40.0).clip(0.0, 40.0)


def half_dead(scan: Array) -> Array:
    """51 % dead beams, ten of those that see the wall among the working ones."""
    dead = scan.copy()
    order = np.argsort(np.abs(BEARINGS))
    dead[order[10:102]] = np.nan
    return dead


DEFECTS: dict[str, Defect] = {
    "nan": lambda scan, last, step: np.full(180, np.nan),
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
    "every other scan dead": lambda scan, last, step: scan if step % 2 else np.full(180, np.nan),
    "frozen and dead in turn": lambda scan, last, step: last if step % 2 else np.full(180, np.nan),
}


def drive(
    defect: Defect, *, distance: float = 30.0, healthy: int = 10, steps: int = 120
) -> tuple[float, float]:
    """Towards a wall at 8 m/s with a scanner that fails: distance left [m] and last speed [m/s]."""
    barrier, shield = ObstacleBarrier(BarrierConfig(), LIMITS), SafetyFilter(LIMITS)
    speed, noise = 8.0, np.random.default_rng(0)
    shield.reset([0.0, speed])
    last = wall(distance)
    for step in range(steps):
        scan = wall(distance)
        scan = scan + noise.normal(0.0, 0.01, 180) * (scan < 40.0)
        if step < healthy:
            last = scan
        else:
            scan = defect(scan, last, step)
        barrier.update(scan, speed, 0.0)
        bounds = barrier.bounds([0.0, 8.0], float(shield.previous[0]))
        speed = float(shield.filter([0.0, 8.0], bounds=bounds).safe_action[1])
        distance -= speed * LIMITS.dt
        if distance <= 0.0:
            break
    return distance, speed


@pytest.mark.parametrize("name", DEFECTS)
@pytest.mark.parametrize("healthy", [2, 10, 25])
def test_the_car_stops_before_the_wall(name: str, healthy: int) -> None:
    """Whatever the defect, and from wherever it begins; it does not creep on either."""
    distance, speed = drive(DEFECTS[name], healthy=healthy)
    assert distance > 1.0 and speed == 0.0


@pytest.mark.parametrize("name", ["nan", "zero", "nan ahead", "zero ahead"])
def test_a_scanner_that_fails_on_a_free_road_brings_the_car_to_rest(name: str) -> None:
    """There is nothing to remember: unknown space comes nearer until the car stands."""
    distance, speed = drive(DEFECTS[name], distance=1e3)
    assert speed == 0.0 and 1e3 - distance < 40.0


@pytest.mark.parametrize("name", ["nan", "zero", "nan ahead", "minus infinity"])
def test_a_scanner_that_never_worked_stops_the_car_at_once(name: str) -> None:
    """Before the first scan nothing is known."""
    barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
    assert barrier.bounds([0.0, 8.0], 0.0).max_speed == 0.0
    barrier.update(DEFECTS[name](wall(20.0), FREE, 0), 3.0, 0.0)
    for steering in (0.0, 0.25, -0.5):
        assert barrier.bounds([steering, 8.0], steering).max_speed == 0.0


def test_the_blind_car_stands_whatever_it_steers() -> None:
    """And however long: neither the sharpest turn nor the escape gets it going."""
    barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
    barrier.update(FREE, 8.0, 0.0)
    for step in range(100):
        barrier.update(np.full(180, np.nan), max(8.0 - 0.6 * step, 0.0), 0.0)
    for steering in np.linspace(-0.5, 0.5, 11).tolist():
        for _ in range(60):
            bounds = barrier.bounds([steering, 8.0], steering)
        assert bounds.max_speed == 0.0


@pytest.mark.parametrize("name", [name for name in DEFECTS if "turn" not in name])
def test_a_defect_never_raises_the_bound(name: str) -> None:
    """Scan by scan, against a scanner that works, from a car at constant speed."""
    good, bad = (ObstacleBarrier(BarrierConfig(), LIMITS) for _ in range(2))
    last = wall(20.0)
    for step in range(16):
        scan = wall(20.0 - 0.8 * step)
        good.update(scan, 8.0, 0.0)
        last = scan if step < 4 else last
        bad.update(scan if step < 4 else DEFECTS[name](scan, last, step), 8.0, 0.0)
        bounds = [barrier.bounds([0.0, 8.0], 0.0).max_speed for barrier in (good, bad)]
        assert bounds[1] <= bounds[0] + 0.05


def test_a_single_missing_scan_does_not_brake() -> None:
    """What was free a moment ago still is; the bound stays above the car's fastest speed."""
    barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
    barrier.update(FREE, 12.0, 0.0)
    for _ in range(3):
        barrier.update(np.full(180, np.nan), 12.0, 0.0)
        assert LIMITS.max_speed <= barrier.bounds([0.0, 12.0], 0.0).max_speed < math.inf


def test_a_scanner_that_comes_back_frees_the_car() -> None:
    """With the first scan: what was remembered is forgotten where the beams see."""
    barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
    barrier.update(wall(10.0), 0.0, 0.0)
    for _ in range(70):
        barrier.update(np.full(180, np.nan), 0.0, 0.0)
    assert barrier.bounds([0.0, 8.0], 0.0).max_speed == 0.0
    barrier.update(wall(25.0), 0.0, 0.0)
    assert barrier.bounds([0.0, 8.0], 0.0).max_speed > 10.0


def test_a_repeated_scan_is_no_defect_where_nothing_moves() -> None:
    """A standing car without noise sees the same scan for ever, and an empty road has no ranges."""
    for scan, speed in ((wall(15.0), 0.0), (FREE, 8.0), (np.full(180, np.inf), 8.0)):
        barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
        bounds = []
        for _ in range(40):
            barrier.update(scan, speed, 0.0)
            bounds.append(barrier.bounds([0.0, 0.0], 0.0).max_speed)
        assert len(set(bounds)) == 1 and bounds[0] > 8.0


def test_a_frozen_scanner_is_not_believed_again_once_the_car_stands() -> None:
    """It would show the wall where it was, and the car would go on."""
    barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
    bounds = []
    for step in range(80):
        barrier.update(wall(15.0), max(8.0 - 0.6 * step, 0.0), 0.0)
        bounds.append(barrier.bounds([0.0, 8.0], 0.0).max_speed)
    assert bounds[-1] == 0.0 and max(np.diff(bounds)) < 1e-9


def test_dead_beams_beside_the_way_do_not_stop_the_car() -> None:
    """Nor do single ones ahead, whose neighbours see; five in a row ahead do."""
    for dead, free in ((BEARINGS > 0.9, True), (np.arange(180) % 3 == 0, True)):
        barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
        for _ in range(60):
            barrier.update(np.where(dead, np.nan, FREE), 8.0, 0.0)
        assert (barrier.bounds([0.0, 8.0], 0.0).max_speed == math.inf) == free
    barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
    gap = np.abs(np.arange(180) - 90) <= 2
    for _ in range(60):
        barrier.update(np.where(gap, np.nan, FREE), 8.0, 0.0)
    assert barrier.bounds([0.0, 8.0], 0.0).max_speed == 0.0


def test_scattered_stuck_beams_on_an_empty_road_do_not_stop_the_car() -> None:
    """They are all that returns, and they repeat; a few of them are no frozen scanner."""
    barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
    scan = FREE.copy()
    scan[10::20] = np.random.default_rng(0).uniform(2.0, 39.0, 9)
    for _ in range(60):
        barrier.update(scan, 8.0, 0.0)
    assert barrier.bounds([0.0, 8.0], 0.0).max_speed == math.inf


def test_a_pedestrian_is_remembered_while_the_scanner_is_silent() -> None:
    """They go on walking towards the path."""

    def scan(step: int) -> Array:
        x, y = 22.0 - 0.8 * step, 4.5 - 0.13 * step
        along = x * np.cos(BEARINGS) + y * np.sin(BEARINGS)
        inside = 0.25**2 - (x * x + y * y - along**2)
        return np.where(inside > 0.0, along - np.sqrt(np.maximum(inside, 0.0)), 40.0)

    barrier = ObstacleBarrier(BarrierConfig(), LIMITS)
    for step in range(8):
        barrier.update(scan(step), 8.0, 0.0)
    (before,) = barrier.surroundings.pedestrians
    for _ in range(3):
        barrier.update(np.full(180, np.nan), 8.0, 0.0)
    (after,) = barrier.surroundings.pedestrians
    assert after.number == before.number
    assert after.position - before.position == pytest.approx([-2.4, -0.39], abs=0.15)
    assert barrier.bounds([0.0, 8.0], 0.0).max_speed < 11.0
