"""The follower reaches set-points smoothly and never asks for what the limits forbid."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shield import ActuatorLimits, InvalidProblem, SetpointFollower
from shield.follower import (
    ACCELERATION,
    DECELERATION,
    EMERGENCY,
    JERK,
    LATERAL_JERK,
    STEERING_RISE,
    advance,
)

LIMITS = ActuatorLimits()
FOLLOWER = SetpointFollower(LIMITS)
ROUNDING = 1e-9
DT = LIMITS.dt


def driven(setpoint: tuple[float, float], start: tuple[float, float], steps: int) -> np.ndarray:
    """The start and the commands of a step, from rest (steps + 1, 2)."""
    first = np.array(start)
    return np.vstack([first, FOLLOWER.approach(setpoint, first, first, steps)])


@pytest.mark.parametrize("speed", [0.0, 2.0, 5.0, 9.0, 12.0])
@pytest.mark.parametrize("angle", [-0.5, -0.05, 0.001, 0.3])
def test_a_step_of_the_steering_is_followed_without_overshoot(speed: float, angle: float) -> None:
    """It goes one way only, arrives, and keeps rate, its rise, and the lateral bound."""
    commands = driven((angle, speed), (0.0, speed), 80)
    steering = commands[:, 0] * math.copysign(1.0, angle)
    goal = min(abs(angle), FOLLOWER.sharpest(speed))
    assert steering.max() <= goal + ROUNDING
    assert np.diff(steering).min() >= -ROUNDING
    assert steering[-1] == pytest.approx(goal, abs=1e-6)
    rate = np.diff(steering, prepend=steering[0]) / DT
    comfortable = LATERAL_JERK * LIMITS.wheelbase / max(speed, 1e-3) ** 2
    most = min(LIMITS.max_steering_rate, comfortable)
    assert rate.max() <= most + ROUNDING
    assert np.abs(np.diff(rate)).max() / DT <= comfortable / STEERING_RISE + 1e-6


@pytest.mark.parametrize(("start", "goal"), [(0.0, 9.0), (9.0, 6.5), (5.0, 5.01), (3.0, 0.5)])
def test_a_step_of_the_speed_is_followed_without_overshoot(start: float, goal: float) -> None:
    """It goes one way only, arrives, and keeps comfortable acceleration and jerk."""
    speeds = driven((0.0, goal), (0.0, start), 150)[:, 1]
    acceleration = np.diff(speeds, prepend=start) / DT
    assert speeds[-1] == pytest.approx(goal, abs=1e-6)
    assert (acceleration * math.copysign(1.0, goal - start)).min() >= -1e-7
    assert min(start, goal) - ROUNDING <= speeds.min() <= speeds.max()
    assert speeds.max() <= max(start, goal) + ROUNDING
    assert -DECELERATION - 1e-6 <= acceleration.min() <= acceleration.max() <= ACCELERATION + 1e-6
    assert np.abs(np.diff(acceleration)).max() <= JERK * DT + 1e-6


def test_far_less_speed_is_braked_for_with_all_there_is() -> None:
    """The stopping distance is that of the limit alone, to one period."""
    speeds = driven((0.0, 0.0), (0.0, 9.0), 60)[:, 1]
    at_once = np.maximum(9.0 - LIMITS.deceleration_step * np.arange(len(speeds)), 0.0)
    assert speeds == pytest.approx(at_once, abs=1e-6)
    gentle = driven((0.0, 9.0 - EMERGENCY + 0.01), (0.0, 9.0), 2)[:, 1]
    assert np.diff(gentle).min() > -0.2 * LIMITS.deceleration_step


def test_it_goes_on_from_what_a_shield_has_executed() -> None:
    """Hard braking is released within the jerk; from rest nothing of a turn is gone on with."""
    before, previous = np.array([0.0, 6.0]), np.array([0.0, 5.4])
    nexts = FOLLOWER.approach((0.0, 6.0), previous, before, 3)[:, 1]
    changes = np.diff(nexts, prepend=5.4)
    assert changes[0] >= -DECELERATION * DT
    assert np.abs(np.diff(changes)).max() <= JERK * DT**2 + ROUNDING
    led = np.array([0.06, 0.5])
    assert FOLLOWER.follow((-0.3, 2.0), led, led) == pytest.approx([0.0, 0.53], abs=1e-6)


def test_a_ramp_is_followed_late_by_the_lead() -> None:
    """What lies ahead by `lead` periods is where the command is."""
    rate, speed = np.array([0.004, 0.1]), 2.0
    commands = [np.array([0.0, speed])] * 2
    for step in range(25):
        setpoint = np.array([0.0, speed]) + rate * (step + 1)
        commands.append(FOLLOWER.follow(setpoint, commands[-1], commands[-2]))
    late = (setpoint - commands[-1]) / rate + 1.0
    assert late == pytest.approx(FOLLOWER.lead, abs=0.6)


OTHERS = ActuatorLimits(
    dt=0.05,
    max_steering_rate=0.2,
    min_speed=-3.0,
    max_acceleration=1.0,
    max_deceleration=1.0,
    max_lateral_acceleration=2.0,
)
WITHOUT_G3 = ActuatorLimits(max_lateral_acceleration=None)
shares = st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0))


@given(
    limits=st.sampled_from([LIMITS, OTHERS, WITHOUT_G3]),
    setpoint=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
    place=shares,
    change=shares,
)
def test_no_command_breaks_a_limit(
    limits: ActuatorLimits,
    setpoint: tuple[float, float],
    place: tuple[float, float],
    change: tuple[float, float],
) -> None:
    """Without any tolerance, from whatever was executed before, for ever."""
    follower = SetpointFollower(limits)
    before = limits.low + np.array(place) * (limits.high - limits.low)
    step = -limits.max_decrease + np.array(change) * (limits.max_increase + limits.max_decrease)
    previous = np.clip(before + step, limits.low, limits.high)
    sharpest = follower.sharpest(float(previous[1]))
    previous[0] = np.clip(previous[0], -sharpest, sharpest)
    commands = [previous, *follower.approach(setpoint, previous, before, 12)]
    assert not any(limits.violated(after, before) for before, after in pairwise(commands))


@given(error=st.floats(-5.0, 5.0), pole=st.floats(0.1, 0.9), bend=st.floats(0.01, 0.1))
def test_it_comes_to_rest_at_the_goal(error: float, pole: float, bend: float) -> None:
    """From rest, for every pole and bound, never beyond."""
    left, change = error, 0.0
    for _ in range(600):
        change = advance(left, change, (0.3, 0.2), bend, pole)
        left -= change
        assert left * error >= -ROUNDING
    assert abs(left) < 1e-6


def test_it_can_follow_from_rest_again() -> None:
    """At the same set-point nothing happens; of a set-point that is no number it says so."""
    still = np.array([0.1, 4.0])
    assert np.array_equal(FOLLOWER.follow(still, still, still), still)
    assert np.isnan(FOLLOWER.follow((math.nan, 1.0), still, still)).any()
    with pytest.raises(InvalidProblem, match="`setpoint`"):
        FOLLOWER.follow([1.0], still, still)
