"""The CasADi bicycle against numpy, finite differences and geometry."""

import math

import numpy as np
import pytest

from shield import InvalidLimits, InvalidProblem, KinematicBicycle, VehicleGeometry
from shield.vehicle import LateralRows
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


def test_rows_agree_with_numpy_and_finite_differences(rng: np.random.Generator) -> None:
    """Values, gradients and Hessians of v² tan δ / L, through the buffers."""
    rows = LateralRows(BICYCLE, 8)
    commands = rng.uniform([-0.5, -3.0], [0.5, 12.0], (8, 2))

    def value(points: np.ndarray) -> np.ndarray:
        return points[:, 1] ** 2 * np.tan(points[:, 0]) / 2.7

    rows.commands[:] = commands
    rows.evaluate()
    assert rows.values == pytest.approx(value(commands), rel=tolerances.MODEL)
    gradient, hessian = rows.gradient.copy(), rows.hessian.copy()
    for channel in range(2):
        step = np.zeros(2)
        step[channel] = 1e-6
        slope = (value(commands + step) - value(commands - step)) / 2e-6
        assert gradient[:, channel] == pytest.approx(slope, rel=tolerances.GRADIENT, abs=1e-7)
        rows.commands[:] = commands + step
        rows.evaluate()
        ahead = rows.gradient.copy()
        rows.commands[:] = commands - step
        rows.evaluate()
        bend = (ahead - rows.gradient) / 2e-6
        assert hessian[:, channel] == pytest.approx(bend, rel=tolerances.GRADIENT, abs=1e-6)


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
