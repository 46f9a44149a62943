"""The forward repair always has an answer, and it is exact."""

import numpy as np
from hypothesis import strategies as st

from shield import ActuatorLimits
from shield.projection.repair import is_admissible, lateral_boundary, repair, worst_excess
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import CITY, LINEAR, Array, commands, problems, vehicles
from tests.shield.tiers import two_tiers

Problem = tuple[ActuatorLimits, Array, Array]


@two_tiers(problem=problems())
def test_from_an_admissible_command_the_repair_has_an_exact_answer(problem: Problem) -> None:
    """G1, G2 and G3 hold step by step for any finite wish: the induction of the README."""
    limits, nominal, previous = problem
    got = repair(limits, nominal.ravel().tolist(), *previous.tolist())
    assert got.complete
    actions = np.array(got.commands).reshape(-1, 2)
    assert broken_bounds(limits, actions, previous) == []
    assert is_admissible(limits, got.commands, *previous.tolist())
    assert worst_excess(limits, got.commands, *previous.tolist()) == 0.0
    again = repair(limits, got.commands, *previous.tolist())
    assert again.commands == got.commands, "admissible horizons must pass bit by bit"


@two_tiers(problem=problems())
def test_holding_or_slowing_keeps_the_steering_window_open(problem: Problem) -> None:
    """From an admissible command, the same steering at the same or a lower speed is admissible."""
    limits, _, previous = problem
    slowest = min(max(0.0, limits.min_speed), limits.max_speed)
    target = [previous[0], slowest] * 5
    got = repair(limits, target, *previous.tolist())
    actions = np.array(got.commands).reshape(-1, 2)
    assert (actions[:, 0] == previous[0]).all(), "braking must not need any steering"
    speeds = np.abs(np.concatenate([[previous[1]], actions[:, 1]]))
    assert (np.diff(speeds) <= 0.0).all()
    assert broken_bounds(limits, actions, previous) == []


@two_tiers(data=st.data())
def test_the_check_agrees_with_exact_arithmetic(data: st.DataObject) -> None:
    """`is_admissible` and `worst_excess` on horizons that keep or break any bound."""
    limits = data.draw(vehicles())
    previous, first, second = (data.draw(commands(limits)) for _ in range(3))
    actions = np.array([first, second])
    broken = broken_bounds(limits, actions, previous)
    flat = actions.ravel().tolist()
    assert is_admissible(limits, flat, *previous.tolist()) == (not broken)
    assert (worst_excess(limits, flat, *previous.tolist()) > 0.0) == bool(broken)


@two_tiers(data=st.data())
def test_from_an_inadmissible_command_the_rest_is_approached_at_full_rate(
    data: st.DataObject,
) -> None:
    """The box wins, rates hold where it lets them, the lateral bound is approached at full rate."""
    limits = data.draw(vehicles())
    low, high = limits.low, limits.high
    shares = np.array([data.draw(st.floats(-2.0, 3.0)), data.draw(st.floats(-2.0, 3.0))])
    previous = low + (high - low + 1.0) * shares
    target = data.draw(commands(limits))
    got = repair(limits, target.tolist(), *previous.tolist())
    command = np.array(got.commands)
    broken = broken_bounds(limits, [command], previous)
    assert not [name for name in broken if name.startswith("box")]
    assert got.complete == (not broken)
    for channel, name in enumerate(("steering", "speed")):
        if f"rate {name} 0" in broken:
            outside = max(low[channel] - previous[channel], previous[channel] - high[channel])
            assert outside > 0.0, "only the box may break a rate"
            assert command[channel] in (low[channel], high[channel])
        if "lateral 0" in broken:
            held = min(max(0.0, low[channel]), high[channel])
            step = limits.max_decrease if previous[channel] > held else limits.max_increase
            nearest = max(abs(previous[channel] - held) - step[channel], 0.0)
            excess = abs(command[channel] - held) - nearest
            assert excess <= 1e-9 * (1.0 + abs(previous[channel]))


def test_the_boundary_is_found_from_outside_and_left_alone_without_a_bound() -> None:
    """Newton's steps end on the boundary; degenerate starts come back."""
    delta, v = lateral_boundary(CITY, 0.3, 11.0, (1.0, 1.0))
    assert (
        v * v * np.tan(delta) / 2.7 == np.float64(4.0)
        or abs(v * v * np.tan(delta) / 2.7 - 4.0) < 1e-3
    )
    assert lateral_boundary(CITY, 0.0, 0.0, (1.0, 1.0)) == (0.0, 0.0)
    assert lateral_boundary(LINEAR, 0.3, 11.0, (1.0, 1.0)) == (0.3, 11.0)


def test_values_that_are_not_finite_are_not_admissible() -> None:
    """NaN compares false with everything, and must not slip through."""
    assert not is_admissible(CITY, [np.nan, 1.0], 0.0, 1.0)
    assert not is_admissible(CITY, [0.0, np.nan], 0.0, 1.0)
    assert not is_admissible(CITY, [np.inf, 1.0], 0.0, 1.0)
