"""`ActuatorLimits` refuses nonsense and judges commands exactly."""

import math
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import ActuatorLimits, InvalidLimits, InvalidProblem, ShieldError
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import CITY, VEHICLES, admissible_commands, commands, vehicles
from tests.shield.tiers import two_tiers


@pytest.mark.parametrize("field", [field.name for field in fields(ActuatorLimits)])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "1", True, 1j, [1.0]])
def test_every_field_refuses_what_is_not_a_finite_number(field: str, value: Any) -> None:
    """The error names the field and shows the value, and is a `ValueError` too."""
    with pytest.raises(InvalidLimits, match=f"`{field}`.*Got") as caught:
        replace(CITY, **{field: value})
    assert isinstance(caught.value, ShieldError)
    assert isinstance(caught.value, ValueError)
    assert repr(value) in str(caught.value)


POSITIVE = ("dt", "max_steering", "max_steering_rate", "max_acceleration", "max_deceleration")


@pytest.mark.parametrize("field", [*POSITIVE, "max_lateral_acceleration", "wheelbase"])
@pytest.mark.parametrize("value", [0.0, -1.0, 1e-300, 1e300])
def test_positive_fields_refuse_zero_negative_and_absurd_values(field: str, value: float) -> None:
    """A bound of size zero would freeze the vehicle; an absurd one is a mistake of units."""
    with pytest.raises(InvalidLimits, match=f"`{field}`"):
        replace(CITY, **{field: value})


def test_low_above_high_and_a_right_angle_are_impossible() -> None:
    """A minimum above the maximum and a steering angle of 90° raise."""
    with pytest.raises(InvalidLimits, match=r"min_speed=3.0, max_speed=2.0"):
        replace(CITY, min_speed=3.0, max_speed=2.0)
    with pytest.raises(InvalidLimits, match="`max_steering`"):
        replace(CITY, max_steering=math.pi / 2)
    with pytest.raises(InvalidLimits, match="`max_speed`"):
        replace(CITY, max_speed=1e13)


def test_limits_cannot_be_changed_and_accept_integers() -> None:
    """The dataclass is frozen, its arrays are read-only, and 1 means 1.0."""
    limits = replace(CITY, max_speed=12, max_steering=np.float32(0.5))
    assert isinstance(limits.max_speed, float)
    assert isinstance(limits.max_steering, float)
    with pytest.raises(FrozenInstanceError):
        limits.dt = 1.0  # type: ignore[misc]
    for array in (limits.low, limits.high, limits.max_increase, limits.max_decrease):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


@pytest.mark.parametrize("limits", VEHICLES)
def test_actions_and_commands_are_inverse_and_meet_at_the_corners(limits: ActuatorLimits) -> None:
    """-1 and 1 are the exact ends of the box; there and back loses rounding errors only."""
    low, high = limits.to_command([-1.0, -1.0]), limits.to_command([1.0, 1.0])
    assert low.tolist() == limits.low.tolist()
    assert high.tolist() == limits.high.tolist()
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 4, 2))
    inside = limits.to_command(actions)
    assert ((limits.low <= inside) & (inside <= limits.high)).all()
    if limits.min_speed < limits.max_speed:
        assert np.abs(limits.to_action(inside) - actions).max() < 1e-14
        assert (np.abs(limits.to_command([1.5, -1.5])) > 0).any()
        assert limits.to_command([2.0, 2.0])[1] > limits.max_speed
    else:
        assert (limits.to_action(inside)[..., 1] == 0.0).all()


def test_wrong_shapes_raise() -> None:
    """Naming the argument and the shape."""
    with pytest.raises(InvalidProblem, match=r"`action`.*\(3,\)"):
        CITY.to_command(np.zeros(3))
    with pytest.raises(InvalidProblem, match=r"`command`.*\(\)"):
        CITY.to_action(1.0)
    with pytest.raises(InvalidProblem, match=r"`command`.*\(1, 2\)"):
        CITY.violated(np.zeros((1, 2)), np.zeros(2))
    with pytest.raises(InvalidProblem, match=r"`previous`.*\(3,\)"):
        CITY.violated(np.zeros(2), np.zeros(3))
    with pytest.raises(InvalidProblem, match="`command`.*numbers"):
        CITY.violated("fast", np.zeros(2))
    with pytest.raises(InvalidProblem, match="`action`.*numbers"):
        CITY.to_command([None, 1.0])


def test_conversions_accept_any_value() -> None:
    """Infinite and huge numbers neither raise nor warn, whatever numpy is told to do."""
    with np.errstate(all="raise"):
        for values in ([math.inf, -math.inf], [math.nan, 1e308], [1.7e308, -1.7e308]):
            assert CITY.to_command(values).shape == (2,)
            assert CITY.to_action(values).shape == (2,)
            assert CITY.lateral_acceleration(values).shape == ()


@two_tiers(data=st.data())
def test_violated_agrees_with_exact_arithmetic(data: st.DataObject) -> None:
    """On random commands, on the edges of the windows, and an ulp beyond them."""
    limits = data.draw(vehicles())
    previous = data.draw(commands(limits))
    command = data.draw(commands(limits) | admissible_commands(limits))
    if data.draw(st.booleans()):
        channel = data.draw(st.integers(0, 1))
        step = data.draw(st.sampled_from([limits.max_increase, -limits.max_decrease]))
        command[channel] = previous[channel] + step[channel]
        nudge = data.draw(st.sampled_from([None, -np.inf, np.inf]))
        if nudge is not None:
            command[channel] = np.nextafter(command[channel], nudge)
    assert limits.violated(command, previous) == bool(broken_bounds(limits, [command], previous))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_violate(bad: float) -> None:
    """An unknown command is never called admissible."""
    assert CITY.violated([bad, 1.0], [0.0, 1.0])
    assert CITY.violated([0.0, 1.0], [0.0, bad])


def test_lateral_acceleration_is_that_of_the_bicycle() -> None:
    """v² tan δ / L, with the sign of the steering."""
    got = CITY.lateral_acceleration([[0.1, 10.0], [-0.1, 10.0]])
    expected = 100.0 * math.tan(0.1) / 2.7
    assert got == pytest.approx([expected, -expected], rel=1e-15)
