"""Clusters followed from scan to scan."""

import math
from typing import Any

import numpy as np
import pytest

from shield import ClusterTracker, InvalidProblem, Track

DT = 0.1
FORWARD = 3.6


def post(x: float, y: float) -> np.ndarray:
    """Three hits on something narrow, (3, 2)."""
    return np.array([[x, y - 0.1], [x, y], [x, y + 0.1]])


def wall(y: float) -> np.ndarray:
    """Hits on something long, (20, 2)."""
    return np.stack([np.linspace(4.0, 12.0, 20), np.full(20, y)], axis=1)


def drive(
    tracker: ClusterTracker, where: tuple[float, float], walk: tuple[float, float], yaw_rate: float
) -> Track:
    """The last track of somebody who walks in the world while the car drives a bend at 6 m/s."""
    x = y = yaw = 0.0
    track = None
    for step in range(12):
        away = np.array(where) + np.array(walk) * DT * step - [x, y]
        cos, sin = math.cos(yaw), math.sin(yaw)
        seen = (cos * away[0] + sin * away[1] - FORWARD, cos * away[1] - sin * away[0])
        motion = (0.0, 0.0) if step == 0 else (6.0, yaw_rate)
        (track,) = tracker.update(post(*seen), *motion)
        middle = yaw + 0.5 * yaw_rate * DT
        x, y = x + 6.0 * DT * math.cos(middle), y + 6.0 * DT * math.sin(middle)
        yaw += yaw_rate * DT
    assert track is not None
    return track


@pytest.mark.parametrize("yaw_rate", [0.0, 0.3, -0.3])
def test_what_stands_has_no_velocity_however_the_car_moves(yaw_rate: float) -> None:
    """A post seen from a car in a bend stands still."""
    track = drive(ClusterTracker(DT, FORWARD), (25.0, 2.0), (0.0, 0.0), yaw_rate)
    assert track.velocity == pytest.approx([0.0, 0.0], abs=0.02)
    assert track.sightings == 10


def test_a_walker_has_the_velocity_of_his_walk_in_the_cars_axes() -> None:
    """Who walks 1.3 m/s to the left is seen to, on a straight road."""
    track = drive(ClusterTracker(DT, FORWARD), (25.0, -4.0), (0.0, 1.3), 0.0)
    assert track.velocity == pytest.approx([0.0, 1.3], abs=1e-6)


def test_in_a_bend_the_velocity_turns_with_the_axes() -> None:
    """After a turn of psi the world's left is at an angle to the car's left."""
    track = drive(ClusterTracker(DT, FORWARD), (25.0, -4.0), (0.0, 1.3), 0.3)
    psi = 0.3 * DT * 11
    assert track.velocity == pytest.approx([1.3 * math.sin(psi), 1.3 * math.cos(psi)], abs=0.02)


def test_wide_things_are_not_followed() -> None:
    """A wall gives no track; a post beside it does, with its rows."""
    tracker = ClusterTracker(DT, FORWARD)
    assert tracker.update(wall(-5.0), 0.0, 0.0) == []
    (track,) = tracker.update(np.concatenate([wall(-5.0), post(9.0, 4.0)]), 0.0, 0.0)
    assert (track.first, track.last) == (20, 22)
    assert track.width == pytest.approx(0.2)
    assert track.position == pytest.approx([9.0, 4.0])


def test_a_thing_keeps_its_number_through_a_gap_and_a_new_one_gets_another() -> None:
    """Three scans without it are forgiven, four are not."""
    tracker, nothing = ClusterTracker(DT, FORWARD), np.zeros((0, 2))
    (first,) = tracker.update(post(9.0, 0.0), 0.0, 0.0)
    for _ in range(3):
        assert tracker.update(nothing, 0.0, 0.0) == []
    (again,) = tracker.update(post(9.0, 0.0), 0.0, 0.0)
    assert again.number == first.number and again.sightings == 2
    for _ in range(4):
        tracker.update(nothing, 0.0, 0.0)
    (later,) = tracker.update(post(9.0, 0.0), 0.0, 0.0)
    assert later.number != first.number and later.sightings == 1


def test_two_neighbours_are_not_confused() -> None:
    """Each of two posts within reach of each other is matched with the nearer place."""
    tracker = ClusterTracker(DT, FORWARD)
    both = np.array([[9.0, 0.0], [9.0, 0.85]])
    numbers = [[t.number for t in tracker.update(both, 0.0, 0.0)] for _ in range(3)]
    assert numbers[0] == numbers[1] == numbers[2]
    assert len(set(numbers[0])) == 2


def test_a_reset_forgets() -> None:
    """After it the first sighting is a first sighting."""
    tracker = ClusterTracker(DT, FORWARD)
    tracker.update(post(9.0, 0.0), 0.0, 0.0)
    tracker.reset()
    (track,) = tracker.update(post(9.0, 0.0), 0.0, 0.0)
    assert track.sightings == 1


@pytest.mark.parametrize("name", ["dt", "width"])
def test_what_is_not_positive_is_refused(name: str) -> None:
    """The message names the argument and the value."""
    arguments = {"dt": DT, "mount": FORWARD, name: 0.0}
    with pytest.raises(InvalidProblem, match=f"`{name}`.*0"):
        ClusterTracker(**arguments)


def test_a_reset_forgets_everything_and_counts_anew() -> None:
    """Two episodes with the same scans have the same tracks."""
    tracker = ClusterTracker(DT, FORWARD)
    episodes = []
    for _ in range(2):
        tracker.reset()
        episodes.append([tracker.update(post(20.0 - k, 1.0), 5.0, 0.0)[0] for k in (0, 5, 10)])
    first, second = ([(t.number, t.sightings, *t.velocity) for t in each] for each in episodes)
    assert first == second and first[0][0] == 0


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("points", (np.zeros(3), 1.0, 0.0)),
        ("points", ("far", 1.0, 0.0)),
        ("speed", (np.zeros((0, 2)), None, 0.0)),
        ("yaw_rate", (np.zeros((0, 2)), 1.0, "left")),
    ],
)
def test_wrong_types_are_refused_by_name(name: str, arguments: Any) -> None:
    """Before anything has moved."""
    with pytest.raises(InvalidProblem, match=f"`{name}`"):
        ClusterTracker(DT, FORWARD).update(*arguments)
