"""What is beside the car is not forgotten because the LiDAR cannot see it."""

import math

import pytest

from expert.neighbour import Neighbour

DT = 0.1


def overtake(theirs: float, ours: float, seconds: float, noise: float = 0.0) -> Neighbour:
    """Come up to a thing of speed `theirs`, lose it beside the bumper, drive on for a while."""
    neighbour = Neighbour(clear=22.0, hold=3.0, dt=DT, length=4.5)
    gap, sign = 12.0, 1.0
    while gap > 0.0:
        neighbour.update(gap + sign * noise, ours)
        gap, sign = gap - DT * (ours - theirs), -sign
    for _ in range(round(seconds / DT)):
        neighbour.update(math.inf, ours)
    return neighbour


def test_nothing_beside_is_passed_at_once() -> None:
    """With a home lane free for the hold distance there is nothing to wait for."""
    neighbour = Neighbour(clear=22.0, hold=3.0, dt=DT, length=4.5)
    for _ in range(3):
        neighbour.update(math.inf, 8.0)
        assert not neighbour.passed(8.0)
    neighbour.update(math.inf, 8.0)
    neighbour.update(math.inf, 8.0)
    assert neighbour.passed(8.0)


@pytest.mark.parametrize("theirs", [0.0, 2.0, 4.5])
def test_the_speed_comes_from_the_gap(theirs: float) -> None:
    """While it is seen, its speed is known in spite of the LiDAR's noise."""
    neighbour = Neighbour(clear=22.0, hold=3.0, dt=DT, length=4.5)
    gap = 20.0
    for k in range(20):
        neighbour.update(gap + 0.03 * (-1.0) ** k, 7.0)
        gap -= DT * (7.0 - theirs)
    assert neighbour.speed == pytest.approx(theirs, abs=0.15)


def test_a_standing_car_is_passed_after_the_hold_distance() -> None:
    """At 6 m/s the lane change takes long enough to leave it behind."""
    assert not overtake(0.0, 6.0, 0.3).passed(6.0)
    assert overtake(0.0, 6.0, 0.9).passed(6.0)


def test_a_slow_car_stays_beside_while_we_are_as_slow() -> None:
    """Driving along at its speed, for however long, does not pass it; driving faster does."""
    neighbour = overtake(3.0, 5.0, 0.2, noise=0.02)
    for _ in range(100):
        neighbour.update(math.inf, 3.0)
    assert not neighbour.passed(3.0)
    for _ in range(30):
        neighbour.update(math.inf, 6.0)
    assert neighbour.passed(6.0)


def test_what_comes_back_into_sight_is_beside_again() -> None:
    """A neighbour that overtakes us and falls back has to be passed anew."""
    neighbour = overtake(3.0, 7.0, 2.0)
    assert neighbour.passed(7.0)
    neighbour.update(0.5, 3.0)
    assert not neighbour.passed(3.0)
    neighbour.update(math.inf, 3.0)
    assert neighbour.behind < 1.0
