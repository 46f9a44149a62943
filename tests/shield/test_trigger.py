"""Not knowing is a risk, and a verdict does not flicker."""

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import strategies as st

from shield import (
    ClearanceEstimate,
    InvalidLimits,
    InvalidProblem,
    LaneEstimate,
    LaneGeometry,
    RiskTrigger,
    TriggerConfig,
)
from tests.shield.strategies import NASTY
from tests.shield.tiers import two_tiers

CLEAR = ClearanceEstimate(20.0, 0.0, 0.05, 0.0, True)
CENTRED = LaneEstimate(0.0, 0.0, 0.0, 0.0, 0.05, 0.0, True)
QUICK = TriggerConfig(hold_time=0.0)


def verdict(clearance: ClearanceEstimate = CLEAR, lane: LaneEstimate = CENTRED) -> Any:
    """Return the first verdict of a fresh trigger."""
    return RiskTrigger(QUICK, 0.1).update(clearance, lane)


def test_each_reason_raises_risk_by_itself() -> None:
    """And with none of them there is no risk."""
    assert not verdict().risky
    assert verdict().reasons == ()
    assert verdict(replace(CLEAR, clearance=2.9)).reasons == ("clearance",)
    assert verdict(lane=replace(CENTRED, lateral_offset=-1.3)).reasons == ("lane_deviation",)
    assert verdict(replace(CLEAR, age=0.6)).reasons == ("lidar_lost",)
    assert verdict(replace(CLEAR, valid=False)).reasons == ("lidar_lost",)
    assert verdict(lane=replace(CENTRED, age=0.6)).reasons == ("lane_lost",)
    assert verdict(lane=replace(CENTRED, valid=False)).reasons == ("lane_lost",)


def test_uncertainty_counts_against_safety() -> None:
    """An estimate is inflated by its standard deviation to the risky side."""
    assert not verdict(replace(CLEAR, clearance=3.2, std=0.1)).risky
    assert verdict(replace(CLEAR, clearance=3.2, std=0.3)).risky
    assert not verdict(lane=replace(CENTRED, lateral_offset=1.1, offset_std=0.05)).risky
    assert verdict(lane=replace(CENTRED, lateral_offset=1.1, offset_std=0.2)).risky


def test_the_passing_lane_is_not_a_deviation() -> None:
    """The distance is that to the nearest admissible centre."""
    risk = verdict(lane=replace(CENTRED, lateral_offset=3.4))
    assert not risk.risky
    assert risk.lane_deviation == pytest.approx(0.1)
    assert verdict(lane=replace(CENTRED, lateral_offset=1.75)).risky


def test_hysteresis_and_hold_time_end_the_verdict_late() -> None:
    """Above the threshold is not enough, and not for a moment only."""
    trigger = RiskTrigger(TriggerConfig(hold_time=0.3), 0.1)
    assert trigger.update(replace(CLEAR, clearance=2.0), CENTRED).risky
    assert trigger.update(replace(CLEAR, clearance=3.3), CENTRED).reasons == ("clearance",)
    holding = [trigger.update(CLEAR, CENTRED) for _ in range(4)]
    assert [risk.reasons for risk in holding] == [("hold",)] * 3 + [()]
    assert [risk.risky for risk in holding] == [True, True, True, False]
    assert not trigger.update(replace(CLEAR, clearance=3.3), CENTRED).risky
    trigger.update(replace(CLEAR, clearance=2.0), CENTRED)
    trigger.reset()
    assert not trigger.update(CLEAR, CENTRED).risky


def test_a_car_that_does_not_get_on_needs_help() -> None:
    """After the stall time below the stall speed, until it drives again."""
    trigger = RiskTrigger(TriggerConfig(stall_time=0.3, hold_time=0.0), 0.1)
    standing = [trigger.update(CLEAR, CENTRED, speed).reasons for speed in (0.0, 0.9, -0.5, 0.0)]
    assert standing == [(), (), (), ("stalled",)]
    assert trigger.update(CLEAR, CENTRED, 0.9).risky
    assert not trigger.update(CLEAR, CENTRED, 1.0).risky
    assert not trigger.update(CLEAR, CENTRED, 0.0).risky
    trigger.reset()
    assert not any(trigger.update(CLEAR, CENTRED, 0.0).risky for _ in range(3))


@pytest.mark.parametrize(("stall_time", "speed"), [(None, 0.0), (0.3, None), (0.3, math.nan)])
def test_no_car_stalls_whose_speed_is_not_known_or_does_not_matter(
    stall_time: float | None, speed: float | None
) -> None:
    """Without a stall time a car may stand as long as it likes."""
    trigger = RiskTrigger(TriggerConfig(stall_time=stall_time), 0.1)
    assert not any(trigger.update(CLEAR, CENTRED, speed).risky for _ in range(100))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_heading_that_leads_out_of_the_lanes_is_risky(side: float) -> None:
    """Near the centre of an outermost lane or not; a change to the other lane leads nowhere out."""
    config = TriggerConfig(hold_time=0.0, preview_time=1.0)
    trigger = RiskTrigger(config, 0.1, (0.0, 3.5 * side))
    out = replace(CENTRED, lateral_offset=3.6 * side, heading_error=0.4 * side)
    inwards = replace(out, heading_error=-0.4 * side)
    across = replace(CENTRED, lateral_offset=0.5 * side, heading_error=0.4 * side)
    # 4 m/s at 0.4 rad are 1.56 m sideways in a second: to 5.16 m, 1.66 m beyond 3.5 m.
    assert trigger.update(CLEAR, out, 4.0).reasons == ("leaving",)
    assert trigger.update(CLEAR, out, 2.7).risky  # 1.15 m beyond: below the threshold of 1.2 m
    assert not trigger.update(CLEAR, out, 2.2).risky  # 0.96 m: below the hysteresis, too
    assert not trigger.update(CLEAR, out, 2.7).risky
    for lane in (inwards, across):
        assert not trigger.update(CLEAR, lane, 4.0).risky
    for speed in (None, math.nan):
        assert not trigger.update(CLEAR, out, speed).risky
    never = RiskTrigger(replace(config, preview_time=None), 0.1, (0.0, 3.5 * side))
    assert not never.update(CLEAR, out, 4.0).risky


@pytest.mark.parametrize("heading", [math.nan, math.inf])
def test_a_heading_that_is_not_finite_is_a_risk(heading: float) -> None:
    """Where it may lead is not known."""
    trigger = RiskTrigger(TriggerConfig(), 0.1)
    assert trigger.update(CLEAR, replace(CENTRED, heading_error=heading), 1.0).risky


@two_tiers(values=st.lists(NASTY, min_size=6, max_size=6), valid=st.booleans())
def test_an_estimate_that_is_not_finite_is_a_risk(values: list[float], valid: bool) -> None:
    """NaN in any deciding value raises risk; nothing raises an exception."""
    clearance = ClearanceEstimate(values[0], 0.0, values[1], values[2], valid)
    lane = LaneEstimate(values[3], 0.0, 0.0, 0.0, values[4], values[5], valid)
    risk = verdict(clearance, lane)
    if not valid or any(math.isnan(value) for value in values):
        assert risk.risky


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("clearance", 0.0),
        ("clearance", math.nan),
        ("clearance", "near"),
        ("sigma_factor", None),
        ("lane_deviation", -1.0),
        ("sigma_factor", -1.0),
        ("clearance_hysteresis", math.nan),
        ("lane_hysteresis", 1.2),
        ("hold_time", -0.1),
        ("stall_time", -4.0),
        ("preview_time", 0.0),
    ],
)
def test_impossible_thresholds_raise(field: str, value: Any) -> None:
    """Naming the field and the value."""
    with pytest.raises(InvalidLimits, match=f"`{field}`.*Got"):
        TriggerConfig(**{field: value})
    with pytest.raises(InvalidLimits, match="`dt`"):
        RiskTrigger(QUICK, 0.0)
    with pytest.raises(InvalidLimits, match="`config`.*None"):
        RiskTrigger(None, 0.1)  # type: ignore[arg-type]


@pytest.mark.parametrize("centres", [(), (0.0, math.nan), 3.5, ((0.0,),)])
def test_impossible_lane_centres_raise(centres: Any) -> None:
    """Naming the argument and its value."""
    with pytest.raises(InvalidLimits, match="`lane_centres`.*Got"):
        RiskTrigger(QUICK, 0.1, centres)
    with pytest.raises(InvalidProblem, match="`lane_centres`.*numbers"):
        RiskTrigger(QUICK, 0.1, ("left",))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("clearance", (None, CENTRED, 1.0)),
        ("lane", (CLEAR, None, 1.0)),
        ("lane", (CLEAR, CLEAR, 1.0)),
        ("speed", (CLEAR, CENTRED, "1")),
        ("speed", (CLEAR, CENTRED, [1.0])),
    ],
)
def test_wrong_types_raise(name: str, arguments: Any) -> None:
    """Naming the argument."""
    with pytest.raises(InvalidProblem, match=f"`{name}`.*Got"):
        RiskTrigger(QUICK, 0.1).update(*arguments)


def test_wider_lanes_have_other_centres() -> None:
    """The same offset is near the passing lane's centre, or between the lanes."""
    lane = replace(CENTRED, lateral_offset=4.9)
    risks = [
        RiskTrigger(QUICK, 0.1, LaneGeometry(width).centres).update(CLEAR, lane)
        for width in (3.5, 5.0)
    ]
    assert [risk.risky for risk in risks] == [True, False]
