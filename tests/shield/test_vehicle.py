"""The CasADi bicycle against numpy, finite differences and geometry."""

import math

import numpy as np
import pytest

from shield import InvalidLimits, InvalidProblem, KinematicBicycle, VehicleGeometry
from shield.vehicle import carried
from tests.shield import tolerances

BICYCLE = KinematicBicycle(2.7, 0.1)


def test_a_held_command_drives_a_circle() -> None:
    """The heading is exact; the position follows the arc of radius L / tan δ."""
    steering, speed = 0.2, 5.0
    states = BICYCLE.rollout(np.zeros(3), np.tile([steering, speed], (30, 1)))
    radius = 2.7 / math.tan(steering)
    yaw = speed * 0.1 * np.arange(1, 31) / radius
    assert np.abs(states[:, 2] - yaw).max() < 1e-12
    assert np.abs(states[:, 0] - radius * np.sin(yaw)).max() < 1e-6
    assert np.abs(states[:, 1] - radius * (1.0 - np.cos(yaw))).max() < 1e-6
    assert states[-1, 1] > 0.0, "steering to the left must drive to the left"


def test_the_lateral_acceleration_agrees_with_numpy(rng: np.random.Generator) -> None:
    """v² tan δ / L at any command."""
    for steering, speed in rng.uniform([-0.5, -3.0], [0.5, 12.0], (20, 2)):
        got = float(BICYCLE.lateral_acceleration([steering, speed]))
        assert got == pytest.approx(speed**2 * np.tan(steering) / 2.7, rel=tolerances.MODEL)


@pytest.mark.parametrize("yaw_rate", [-0.4, 0.0, 0.7])
def test_what_stands_is_carried_to_where_the_model_sees_it(yaw_rate: float) -> None:
    """Points by the pose after a period of the bicycle; directions by its yaw alone."""
    speed, points = 8.0, np.array([[10.0, -3.0], [0.0, 4.0], [-2.0, 0.0]])
    command = [math.atan(2.7 * yaw_rate / speed), speed]
    (x, y, yaw) = BICYCLE.rollout(np.zeros(3), [command])[0]
    turned = (points[:, 0] + 1j * points[:, 1]) * np.exp(-1j * yaw)
    seen = turned - (x + 1j * y) * np.exp(-1j * yaw)
    got = carried(points, speed, yaw_rate, 0.1)
    assert np.abs(got - np.stack([seen.real, seen.imag], axis=1)).max() < 5e-4
    got = carried(points, 0.0, yaw_rate, 0.1)
    assert np.abs(got - np.stack([turned.real, turned.imag], axis=1)).max() < 1e-9


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_impossible_vehicles_raise(value: float) -> None:
    """Naming the argument."""
    with pytest.raises(InvalidLimits, match="`wheelbase`"):
        KinematicBicycle(value, 0.1)
    with pytest.raises(InvalidLimits, match="`dt`"):
        KinematicBicycle(2.7, value)


def test_rollout_checks_shapes() -> None:
    """States have three entries, commands two."""
    with pytest.raises(InvalidProblem, match=r"`state`.*\(2,\)"):
        BICYCLE.rollout(np.zeros(2), np.zeros((4, 2)))
    with pytest.raises(InvalidProblem, match="`state`.*numbers"):
        BICYCLE.rollout("here", np.zeros((4, 2)))
    with pytest.raises(InvalidProblem, match=r"`commands`.*\(0, 2\)"):
        BICYCLE.rollout(np.zeros(3), np.zeros((0, 2)))


@pytest.mark.parametrize(
    ("field", "value"),
    [("length", 0.0), ("width", -1.0), ("front_bumper", float("nan")), ("front_bumper", 4.5)],
)
def test_an_impossible_outline_is_refused(field: str, value: float) -> None:
    """Naming the field and the value; the rear axle lies inside of the body."""
    assert VehicleGeometry().rear_overhang == pytest.approx(0.9)
    with pytest.raises(InvalidLimits, match=f"`{field}`.*Got"):
        VehicleGeometry(**{field: value})
