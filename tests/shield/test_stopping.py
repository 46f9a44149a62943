"""The speed from which the car still stops."""

import math

import numpy as np
import pytest

from shield import (
    ActuatorLimits,
    InvalidLimits,
    SafetyFilter,
    Status,
    StoppingBarrier,
    StoppingConfig,
)

LIMITS = ActuatorLimits()
CONFIG = StoppingConfig()
BEARINGS = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 180)
FREE = np.full(180, CONFIG.max_range)


def scan_of(*things: tuple[float, float, float]) -> np.ndarray:
    """Ranges (180,) of discs (x, y, radius) in the sensor's frame."""
    ranges = FREE.copy()
    for x, y, radius in things:
        along = x * np.cos(BEARINGS) + y * np.sin(BEARINGS)
        inside = radius**2 - (x * x + y * y - along**2)
        hit = (inside > 0.0) & (along > 0.0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(inside[hit]))
    return ranges


def barrier_after(*scans: np.ndarray, speed: float = 8.0) -> StoppingBarrier:
    """A barrier that has seen these scans from a car driving straight on."""
    barrier = StoppingBarrier(CONFIG, LIMITS)
    for scan in scans:
        barrier.update(scan, speed, 0.0)
    return barrier


def test_nothing_in_the_way_bounds_nothing() -> None:
    """Free road, and things beside it."""
    assert barrier_after(FREE).max_speed(0.0) == math.inf
    assert barrier_after(scan_of((10.0, 4.0, 0.5), (10.0, -4.0, 0.5))).max_speed(0.0) == math.inf


@pytest.mark.parametrize("distance", [3.0, 8.0, 15.0, 25.0])
def test_from_the_bound_the_car_stops_in_front_of_it(distance: float) -> None:
    """Reaction and braking distance together are the free path."""
    bound = barrier_after(scan_of((distance + 0.5, 0.0, 0.5))).max_speed(0.0)
    stops = bound * CONFIG.delay + bound**2 / (2.0 * CONFIG.braking)
    assert stops == pytest.approx(distance - CONFIG.standoff, abs=0.1)


def test_inside_the_standoff_the_car_has_to_stand() -> None:
    """Nearer than the standoff there is no speed left."""
    assert barrier_after(scan_of((1.6, 0.0, 0.4))).max_speed(0.0) == 0.0


def test_the_path_is_the_arc_of_the_steering() -> None:
    """A thing on the arc bounds the speed on it, and not straight on; its mirror image neither."""
    steering = 0.2
    radius = LIMITS.wheelbase / math.tan(steering)
    turn = 12.0 / radius
    centre = (-CONFIG.forward, radius)
    rest = math.hypot(CONFIG.forward, radius)
    start = math.atan2(-radius, CONFIG.forward)
    thing = (
        centre[0] + rest * math.cos(start + turn),
        centre[1] + rest * math.sin(start + turn),
        0.4,
    )
    barrier = barrier_after(scan_of(thing))
    assert barrier.max_speed(steering) < 10.0
    assert barrier.max_speed(-steering) == math.inf
    assert barrier.max_speed(0.0) == math.inf


def test_one_short_beam_is_rain() -> None:
    """Two are not."""
    ranges = FREE.copy()
    ranges[90] = 5.0
    assert barrier_after(ranges).max_speed(0.0) == math.inf
    ranges[91] = 5.0
    assert barrier_after(ranges).max_speed(0.0) < 6.0


def walk(lateral: float, pace: float, steps: int = 8, speed: float = 8.0) -> list[np.ndarray]:
    """Scans of somebody 22 m ahead at first who walks across, seen from a car driving straight."""
    return [scan_of((22.0 - speed * 0.1 * k, lateral + pace * 0.1 * k, 0.25)) for k in range(steps)]


def test_who_walks_towards_the_path_bounds_the_speed_before_he_is_there() -> None:
    """3 m to the left of it and coming: he counts. Standing there, or going away: he does not."""
    assert barrier_after(*walk(4.5, -1.3)).max_speed(0.0) < 11.0
    assert barrier_after(*walk(4.5, 0.0)).max_speed(0.0) == math.inf
    assert barrier_after(*walk(3.5, 1.3)).max_speed(0.0) == math.inf


def test_who_comes_after_the_car_has_passed_does_not_count() -> None:
    """Somebody 12 m beside the path needs 8 s; the car passes in 3."""
    assert barrier_after(*walk(12.0, -1.3)).max_speed(0.0) == math.inf


def test_a_dead_scanner_bounds_nothing_and_nothing_raises() -> None:
    """Not seeing is the trigger's business; values that are no numbers are survived."""
    barrier = barrier_after(np.full(180, np.nan))
    assert barrier.max_speed(0.0) == math.inf
    assert barrier_after(scan_of((8.0, 0.0, 0.5))).max_speed(math.nan) == math.inf
    barrier = barrier_after(scan_of((8.0, 0.0, 0.5)), speed=math.nan)
    assert barrier.max_speed(0.0) < 8.0


def test_a_reset_forgets_what_was_seen() -> None:
    """The next episode begins on a free road."""
    barrier = barrier_after(scan_of((8.0, 0.0, 0.5)))
    assert barrier.max_speed(0.0) < 8.0
    barrier.reset()
    assert barrier.max_speed(0.0) == math.inf


@pytest.mark.parametrize("name", ["braking", "delay", "standoff", "width", "horizon"])
def test_impossible_numbers_are_refused(name: str) -> None:
    """The message names the field and the value."""
    with pytest.raises(InvalidLimits, match=f"`{name}`.*-1"):
        StoppingConfig(**{name: -1.0})


def test_the_filter_slows_to_the_bound_as_fast_as_the_limits_let_it() -> None:
    """From 8 m/s towards 3: 0.6 m/s a step, then the bound, steering untouched."""
    shield = SafetyFilter(LIMITS)
    shield.reset([0.0, 8.0])
    speeds = []
    for _ in range(12):
        certificate = shield.filter([0.05, 8.0], max_speed=3.0)
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
    certificate = shield.filter([0.01, 8.0], max_speed=bound)
    assert certificate.status is Status.NOMINAL and not certificate.intervened
    assert certificate.safe_action.tolist() == [0.01, 8.0]


def test_a_bound_that_is_no_number_stops_the_car() -> None:
    """As fast as the limits let it, and not below the least speed."""
    shield = SafetyFilter(LIMITS)
    shield.reset([0.0, 0.5])
    assert shield.filter([0.0, 5.0], max_speed=math.nan).safe_action[1] == 0.0
    assert shield.filter([0.0, 5.0], max_speed=-3.0).safe_action[1] == 0.0
