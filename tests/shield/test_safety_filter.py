"""One command at a time, tied to the last one executed."""

from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import InvalidProblem, SafetyFilter, Status
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import (
    CITY,
    NASTY,
    VEHICLES,
    admissible_commands,
    commands,
    horizons,
    safety_filter,
)
from tests.shield.tiers import two_tiers


@two_tiers(data=st.data())
def test_every_command_of_an_episode_is_admissible(data: st.DataObject) -> None:
    """G1-G4 in closed loop: any values, now and then a plan, each command after the last one."""
    limits = data.draw(st.sampled_from(VEHICLES))
    shield = safety_filter(limits)
    shield.reset(data.draw(admissible_commands(limits)))
    for _ in range(data.draw(st.integers(1, 8))):
        previous = shield.previous
        wish = data.draw(
            commands(limits)
            | horizons(limits, 1, previous).map(lambda rows: rows[0])
            | st.tuples(NASTY, NASTY).map(np.array)
        )
        plan = data.draw(st.none() | horizons(limits, 4, previous))
        with np.errstate(all="ignore"):
            certificate = shield.filter(wish, plan)
        assert broken_bounds(limits, [certificate.safe_action], previous) == []
        assert certificate.max_violation == 0.0
        assert shield.previous is certificate.safe_action
        assert certificate.intervened == (certificate.status is not Status.NOMINAL)
        admissible = np.isfinite(wish).all() and not broken_bounds(limits, [wish], previous)
        assert (certificate.status is Status.NOMINAL) == admissible
        if admissible:
            assert certificate.safe_action.tobytes() == wish.tobytes()
        if not np.isfinite(wish).all():
            assert certificate.status is Status.FALLBACK
            assert certificate.reason


def test_a_lost_command_is_replaced_by_the_rest_of_the_plan_then_brakes() -> None:
    """NaN three times after a plan of three."""
    shield = SafetyFilter(CITY)
    shield.reset([0.0, 5.0])
    plan = np.array([[0.01, 5.1], [0.02, 5.2], [0.03, 5.3]])
    assert shield.filter(plan[0], plan).status is Status.NOMINAL
    for expected, what in ((plan[1], "plan"), (plan[2], "plan"), ([0.03, 4.7], "braking")):
        certificate = shield.filter([np.nan, np.nan])
        assert certificate.status is Status.FALLBACK
        assert what in certificate.reason
        assert certificate.safe_action == pytest.approx(expected, abs=1e-12)
        assert np.isnan(certificate.correction).all()


def test_a_plan_does_not_touch_an_admissible_command() -> None:
    """Even if the plan itself is nonsense."""
    shield = SafetyFilter(CITY)
    shield.reset([0.0, 5.0])
    certificate = shield.filter([0.01, 5.1], np.full((8, 2), np.inf))
    assert certificate.status is Status.NOMINAL
    assert shield.filter([np.nan, 0.0]).reason.endswith("braking")


def test_reset_says_what_was_executed() -> None:
    """Nothing: rest. Values that are not finite: rest. An inadmissible command: kept as it is."""
    shield = SafetyFilter(CITY)
    assert shield.previous.tolist() == [0.0, 0.0]
    shield.reset([0.1, 5.0])
    assert shield.previous.tolist() == [0.1, 5.0]
    shield.reset([np.nan, 5.0])
    assert shield.previous.tolist() == [0.0, 5.0]
    shield.reset([0.5, 12.0])
    certificate = shield.filter([0.5, 12.0])
    assert certificate.status is Status.FALLBACK
    assert certificate.max_violation > 0.0
    assert certificate.safe_action == pytest.approx([0.44, 11.4])
    shield.reset()
    assert shield.previous.tolist() == [0.0, 0.0]


def test_record_corrects_what_was_executed() -> None:
    """Actuators that round are told so."""
    shield = SafetyFilter(CITY)
    shield.record([0.1, 4.0])
    assert shield.previous.tolist() == [0.1, 4.0]
    with pytest.raises(InvalidProblem, match="`command` must be finite"):
        shield.record([np.nan, 0.0])


def test_callers_arrays_stay_writable_and_results_do_not() -> None:
    """The filter works on copies; what it returns is read-only."""
    shield = SafetyFilter(CITY)
    wish = np.array([0.0, 0.1])
    certificate = shield.filter(wish)
    wish[0] = 1.0
    assert certificate.nominal_action.tolist() == [0.0, 0.1]
    for array in (certificate.nominal_action, certificate.safe_action, certificate.correction):
        assert not array.flags.writeable


@pytest.mark.parametrize(
    ("method", "arguments", "name"),
    [
        ("filter", (np.zeros(3),), "nominal"),
        ("filter", (np.zeros((1, 2)),), "nominal"),
        ("filter", (np.zeros(2), np.zeros(2)), "plan"),
        ("filter", (np.zeros(2), np.zeros((0, 2))), "plan"),
        ("reset", (np.zeros(3),), "command"),
        ("record", (np.zeros(3),), "command"),
    ],
)
def test_wrong_shapes_raise(method: str, arguments: tuple[Any, ...], name: str) -> None:
    """Naming the argument."""
    with pytest.raises(InvalidProblem, match=f"`{name}`"):
        getattr(SafetyFilter(CITY), method)(*arguments)
