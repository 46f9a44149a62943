"""Bounds on the next command from what is around the car."""

import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import pytest

from shield import (
    ActuatorLimits,
    BarrierConfig,
    CommandBounds,
    InvalidLimits,
    InvalidProblem,
    ObstacleBarrier,
    SafetyFilter,
    ScannerGeometry,
    Status,
    VehicleGeometry,
)
from shield.world.barrier import ESCAPE_SPEED
from shield.world.flanks import FLANK_MARGIN

LIMITS = ActuatorLimits()
CONFIG = BarrierConfig()
SCANNER = ScannerGeometry()
VEHICLE = VehicleGeometry()
BEARINGS = SCANNER.angles
FREE = np.full(180, SCANNER.max_range)


def scan_of(*things: tuple[float, float, float]) -> np.ndarray:
    """Ranges (180,) of discs (x, y, radius) in the sensor's frame."""
    ranges = FREE.copy()
    for x, y, radius in things:
        along = x * np.cos(BEARINGS) + y * np.sin(BEARINGS)
        inside = radius**2 - (x * x + y * y - along**2)
        hit = (inside > 0.0) & (along > 0.0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(inside[hit]))
    return ranges


def barrier_after(*scans: np.ndarray, speed: float = 8.0) -> ObstacleBarrier:
    """A barrier that has seen these scans from a car driving straight on."""
    barrier = ObstacleBarrier(CONFIG, LIMITS)
    for scan in scans:
        barrier.update(scan, speed, 0.0)
    return barrier


def max_speed(barrier: ObstacleBarrier, steering: float = 0.0) -> float:
    """Bound on the speed with wheels that are turned already."""
    return barrier.bounds(np.array([steering, 8.0]), steering).max_speed


def test_nothing_in_the_way_bounds_nothing() -> None:
    """Free road, and things beside it."""
    assert max_speed(barrier_after(FREE)) == math.inf
    assert max_speed(barrier_after(scan_of((10.0, 4.0, 0.5), (10.0, -4.0, 0.5)))) == math.inf


@pytest.mark.parametrize("distance", [3.0, 8.0, 15.0, 25.0])
def test_from_the_bound_the_car_stops_in_front_of_it(distance: float) -> None:
    """Reaction and braking distance together are the free path."""
    bound = max_speed(barrier_after(scan_of((distance + 0.5, 0.0, 0.5))), 0.0)
    stops = bound * CONFIG.delay + bound**2 / (2.0 * CONFIG.braking)
    assert stops == pytest.approx(distance - CONFIG.standoff, abs=0.1)


def test_inside_the_standoff_the_car_has_to_stand() -> None:
    """Nearer than the standoff there is no speed left."""
    assert max_speed(barrier_after(scan_of((1.6, 0.0, 0.4)))) == 0.0


def test_the_path_is_the_arc_of_the_steering() -> None:
    """A thing on the arc bounds the speed on it, and not straight on; its mirror image neither."""
    steering = 0.2
    radius = LIMITS.wheelbase / math.tan(steering)
    turn = 12.0 / radius
    centre = (-SCANNER.mount, radius)
    rest = math.hypot(SCANNER.mount, radius)
    start = math.atan2(-radius, SCANNER.mount)
    thing = (
        centre[0] + rest * math.cos(start + turn),
        centre[1] + rest * math.sin(start + turn),
        0.4,
    )
    barrier = barrier_after(scan_of(thing))
    assert max_speed(barrier, steering) < 10.0
    assert max_speed(barrier, -steering) == math.inf
    assert max_speed(barrier) == math.inf


def test_one_short_beam_is_rain() -> None:
    """Two are not."""
    ranges = FREE.copy()
    ranges[90] = 5.0
    assert max_speed(barrier_after(ranges)) == math.inf
    ranges[91] = 5.0
    assert max_speed(barrier_after(ranges)) < 6.0


def test_rain_before_a_thing_does_not_bring_it_nearer() -> None:
    """The bound is that of what two beams agree on."""
    alone = scan_of((20.0, 0.0, 0.8))
    wet = alone.copy()
    wet[90] = 4.0
    assert max_speed(barrier_after(wet)) == pytest.approx(max_speed(barrier_after(alone)), abs=0.1)


def test_it_counts_on_no_more_braking_than_the_actuators_have() -> None:
    """A car that brakes half as hard has to be slower before the same thing."""
    gentle = ActuatorLimits(max_deceleration=3.0)
    bounds = []
    for limits in (LIMITS, gentle):
        barrier = ObstacleBarrier(CONFIG, limits)
        barrier.update(scan_of((20.0, 0.0, 0.8)), 8.0, 0.0)
        bounds.append(barrier.bounds(np.array([0.0, 8.0]), 0.0).max_speed)
    room = 20.0 - 0.8 - CONFIG.standoff
    lost = 3.0 * CONFIG.delay
    assert bounds[1] == pytest.approx(math.sqrt(lost**2 + 6.0 * room) - lost, abs=0.2)
    assert bounds[1] < bounds[0] - 2.0


def walk(lateral: float, pace: float, steps: int = 8, speed: float = 8.0) -> list[np.ndarray]:
    """Scans of somebody 22 m ahead at first who walks across, seen from a car driving straight."""
    return [scan_of((22.0 - speed * 0.1 * k, lateral + pace * 0.1 * k, 0.25)) for k in range(steps)]


def test_who_walks_towards_the_path_bounds_the_speed_before_he_is_there() -> None:
    """3 m to the left of it and coming: he counts. Standing there, or going away: he does not."""
    assert max_speed(barrier_after(*walk(4.5, -1.3))) < 11.0
    assert max_speed(barrier_after(*walk(4.5, 0.0))) == math.inf
    assert max_speed(barrier_after(*walk(3.5, 1.3))) == math.inf


def test_who_comes_after_the_car_has_passed_does_not_count() -> None:
    """Somebody 14 m beside the path needs 9 s; the car passes in 3."""
    assert max_speed(barrier_after(*walk(14.0, -1.3))) == math.inf


def test_values_that_are_not_finite_are_survived() -> None:
    """They count as the last known ones."""
    barrier = barrier_after(scan_of((8.0, 0.0, 0.5)))
    assert barrier.bounds([math.nan, 8.0], 0.0) == barrier.bounds(np.zeros(2), 0.0)
    assert barrier.bounds(np.zeros(2), math.nan) == barrier.bounds(np.zeros(2), 0.0)
    barrier = barrier_after(scan_of((8.0, 0.0, 0.5)), speed=math.nan)
    assert max_speed(barrier) < 8.0


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("command", lambda barrier: barrier.bounds(None, 0.0)),
        ("command", lambda barrier: barrier.bounds(["a", 1.0], 0.0)),
        ("command", lambda barrier: barrier.bounds(np.zeros(3), 0.0)),
        ("command", lambda barrier: barrier.bounds(np.zeros((1, 2)), 0.0)),
        ("previous", lambda barrier: barrier.bounds(np.zeros(2), np.zeros(2))),
        ("previous", lambda barrier: barrier.bounds(np.zeros(2), None)),
        ("speed", lambda barrier: barrier.update(FREE, None, 0.0)),
        ("speed", lambda barrier: barrier.update(FREE, "5", 0.0)),
        ("speed", lambda barrier: barrier.update(FREE, [5.0], 0.0)),
        ("yaw_rate", lambda barrier: barrier.update(FREE, 5.0, "a")),
        ("yaw_rate", lambda barrier: barrier.update(FREE, 5.0, None)),
        ("scan", lambda barrier: barrier.update(None, 5.0, 0.0)),
        ("scan", lambda barrier: barrier.update("scan", 5.0, 0.0)),
        ("scan", lambda barrier: barrier.update(FREE[:90], 5.0, 0.0)),
        ("scan", lambda barrier: barrier.update(FREE[None], 5.0, 0.0)),
        ("scan", lambda barrier: barrier.update(FREE * 1j, 5.0, 0.0)),
        ("scan", lambda barrier: barrier.update([[1.0], [1.0, 2.0]], 5.0, 0.0)),
        ("bounds", lambda _: SafetyFilter(LIMITS).filter([0.0, 1.0], bounds=None)),
        ("bounds", lambda _: SafetyFilter(LIMITS).filter([0.0, 1.0], bounds=3.0)),
        ("max_speed", lambda _: CommandBounds(max_speed="3")),  # type: ignore[arg-type]
        ("left", lambda _: CommandBounds(left=None)),  # type: ignore[arg-type]
    ],
)
def test_wrong_types_are_refused_by_name(name: str, call: Callable[[Any], object]) -> None:
    """With `InvalidProblem`, before anything has changed."""
    barrier = barrier_after(scan_of((8.0, 0.0, 0.5)))
    before = max_speed(barrier)
    with pytest.raises(InvalidProblem, match=f"`{name}`"):
        call(barrier)
    assert max_speed(barrier) == before


def test_lists_and_integers_are_accepted() -> None:
    """Whatever numpy takes for numbers."""
    barrier = ObstacleBarrier(CONFIG, LIMITS)
    barrier.update([20] * 180, 5, np.float32(0.0))
    of_list = barrier.bounds([0, 5], np.float32(0.0))
    assert of_list == barrier.bounds(np.array([0.0, 5.0]), 0.0) and of_list.max_speed < 15.0


def test_a_reset_forgets_what_was_seen() -> None:
    """The next episode begins with nothing known; its first scan shows a free road."""
    barrier = barrier_after(scan_of((8.0, 0.0, 0.5)))
    assert max_speed(barrier) < 8.0
    barrier.reset()
    assert max_speed(barrier) == 0.0
    barrier.update(FREE, 8.0, 0.0)
    assert max_speed(barrier) == math.inf


@pytest.mark.parametrize("name", ["braking", "delay", "standoff", "standstill_time"])
def test_impossible_numbers_are_refused(name: str) -> None:
    """The message names the field and the value."""
    for value in (-1.0, 0.0, math.nan, math.inf):
        with pytest.raises(InvalidLimits, match=f"`{name}`.*{value}"):
            BarrierConfig(**{name: value})  # type: ignore[arg-type]


def pass_by(side: float, pace: float = 0.0) -> ObstacleBarrier:
    """A barrier after 5 m/s past a car whose flank is 0.5 m beside the own one (1.4 m off)."""
    scans = []
    gained = 0.1 * (5.0 - pace)
    for step in range(round(7.5 / gained) + 1):
        rear = 5.0 - gained * step
        flank = [(rear + 0.4 * k, side * 1.9, 0.5) for k in range(10)]
        scans.append(scan_of(*flank))
    return barrier_after(*scans, speed=5.0)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_beside_a_car_the_steering_towards_it_is_bounded(side: float) -> None:
    """Also once the scanner has passed its rear; the other side and straight on are free."""
    bounds = pass_by(side).bounds(np.zeros(2), 0.0)
    towards, away = (-bounds.right, bounds.left) if side < 0.0 else (bounds.left, -bounds.right)
    assert 0.0 <= towards < 0.3
    assert away == math.inf


def test_with_the_bound_the_flank_stays_clear_and_beyond_it_it_does_not() -> None:
    """Drive the circle of the bound, and one half as sharp again, past a point beside the car."""
    half = 0.5 * VEHICLE.width + FLANK_MARGIN
    barrier = barrier_after(FREE)
    point = np.array([2.0, 1.6])
    barrier.surroundings.beside = point[None] - [SCANNER.mount, 0.0]
    sharpest = barrier.bounds(np.zeros(2), 0.0).left

    def nearest(steering: float) -> float:
        radius = LIMITS.wheelbase / math.tan(steering)
        angle = np.linspace(0.0, 1.0, 2000)
        x = point[0] * np.cos(angle) + (point[1] - radius) * np.sin(angle)
        y = radius - point[0] * np.sin(angle) + (point[1] - radius) * np.cos(angle)
        return float(np.abs(y[x > 0.0]).min())

    assert nearest(sharpest) == pytest.approx(half, abs=1e-3)
    assert nearest(1.5 * sharpest) < half


def test_what_has_been_left_behind_is_forgotten() -> None:
    """Two and a half seconds later nothing bounds the steering."""
    barrier = pass_by(1.0)
    for _ in range(25):
        barrier.update(FREE, 5.0, 0.0)
    assert barrier.bounds(np.zeros(2), 0.0).left == math.inf


def test_a_car_that_drives_along_is_remembered_longer() -> None:
    """It goes out of sight beside the car and stays there."""
    standing, driving = pass_by(1.0), pass_by(1.0, pace=3.0)
    for barrier in (standing, driving):
        for _ in range(20):
            barrier.update(FREE, 5.0, 0.0)
    assert standing.bounds(np.zeros(2), 0.0).left == math.inf
    assert driving.bounds(np.zeros(2), 0.0).left < 0.5


@pytest.mark.parametrize("wanted", [0.1, 8.0])
def test_who_has_stood_long_enough_steers_free(wanted: float) -> None:
    """In front of a post the car stands; after a while it gets the nearest way out."""
    barrier = barrier_after(scan_of((1.8, -0.8, 0.4)), speed=0.0)
    wish = np.array([-0.05, wanted])
    assert barrier.bounds(wish, 0.0).max_speed == 0.0
    for _ in range(int(CONFIG.standstill_time / LIMITS.dt) + 1):
        bounds = barrier.bounds(wish, 0.0)
    assert bounds.left == bounds.right > 0.1
    assert barrier.bounds(wish, bounds.left).max_speed == ESCAPE_SPEED
    assert barrier.bounds(np.zeros(2), 0.0).max_speed == 0.0


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_it_steers_free_on_the_side_on_which_one_overtakes(
    side: Literal["left", "right"], sign: float
) -> None:
    """Both sides are free and neither is nearer; a wish for the other side is heard."""
    config = BarrierConfig(overtaking=side)
    for wish, way in ((0.0, sign), (-0.2 * sign, -sign)):
        barrier = ObstacleBarrier(config, LIMITS)
        barrier.update(scan_of((3.2, 0.0, 0.6)), 0.0, 0.0)
        for _ in range(int(config.standstill_time / LIMITS.dt) + 1):
            bounds = barrier.bounds(np.array([wish, 8.0]), 0.0)
        assert bounds.left == bounds.right
        assert math.copysign(1.0, bounds.left) == way
    with pytest.raises(InvalidLimits, match="`overtaking`.*up"):
        BarrierConfig(overtaking="up")  # type: ignore[arg-type]


def test_the_filter_slows_to_the_bound_as_fast_as_the_limits_let_it() -> None:
    """From 8 m/s towards 3: 0.6 m/s a step, then the bound, steering untouched."""
    shield = SafetyFilter(LIMITS)
    shield.reset([0.0, 8.0])
    speeds = []
    for _ in range(12):
        certificate = shield.filter([0.05, 8.0], bounds=CommandBounds(max_speed=3.0))
        assert certificate.intervened and certificate.status is Status.PROJECTED
        assert "3.00" in certificate.reason
        assert certificate.correction == pytest.approx(certificate.safe_action - [0.05, 8.0])
        speeds.append(certificate.safe_action[1])
    assert speeds[0] == pytest.approx(8.0 - LIMITS.deceleration_step)
    assert speeds[-1] == 3.0
    assert certificate.safe_action[0] == 0.05


@pytest.mark.parametrize("bound", [8.0, 9.0, math.inf])
def test_a_bound_that_does_not_bind_passes_bit_by_bit(bound: float) -> None:
    """The command is the nominal one, and nothing is said."""
    shield = SafetyFilter(LIMITS)
    shield.reset([0.0, 8.0])
    certificate = shield.filter([0.01, 8.0], bounds=CommandBounds(max_speed=bound))
    assert certificate.status is Status.NOMINAL and not certificate.intervened
    assert certificate.safe_action.tolist() == [0.01, 8.0]


def test_a_bound_that_is_no_number_stops_the_car() -> None:
    """As fast as the limits let it, and not below the least speed."""
    shield = SafetyFilter(LIMITS)
    shield.reset([0.0, 0.5])
    assert shield.filter([0.0, 5.0], bounds=CommandBounds(max_speed=math.nan)).safe_action[1] == 0.0
    assert shield.filter([0.0, 5.0], bounds=CommandBounds(max_speed=-3.0)).safe_action[1] == 0.0


def test_a_car_that_stands_already_is_not_stopped() -> None:
    """A bound below the least speed asks for nothing more than that speed."""
    shield = SafetyFilter(LIMITS)
    certificate = shield.filter([0.0, 0.0], bounds=CommandBounds(max_speed=-3.0))
    assert certificate.status is Status.NOMINAL and not certificate.intervened


def test_the_filter_steers_to_the_bound_as_fast_as_the_limits_let_it() -> None:
    """0.06 rad a step, then the bound; the speed is untouched."""
    shield = SafetyFilter(LIMITS)
    shield.reset([0.0, 3.0])
    steerings = [
        shield.filter([0.4, 3.0], bounds=CommandBounds(left=0.1)).safe_action[0] for _ in range(3)
    ]
    assert steerings == pytest.approx([0.06, 0.1, 0.1])
    assert shield.previous[1] == 3.0
