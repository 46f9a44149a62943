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
PRINTED = TriggerConfig(form="printed")


def verdict(clearance: ClearanceEstimate = CLEAR, lane: LaneEstimate = CENTRED) -> Any:
    """Return the first verdict of a fresh trigger."""
    return RiskTrigger(PRINTED, 0.1).update(clearance, lane)


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
    trigger = RiskTrigger(PRINTED, 0.1)
    assert trigger.update(replace(CLEAR, clearance=2.0), CENTRED).risky
    assert trigger.update(replace(CLEAR, clearance=3.3), CENTRED).reasons == ("clearance",)
    holding = [trigger.update(CLEAR, CENTRED) for _ in range(6)]
    assert [risk.reasons for risk in holding] == [("hold",)] * 5 + [()]
    assert [risk.risky for risk in holding] == [True] * 5 + [False]
    assert not trigger.update(replace(CLEAR, clearance=3.3), CENTRED).risky
    trigger.update(replace(CLEAR, clearance=2.0), CENTRED)
    trigger.reset()
    assert not trigger.update(CLEAR, CENTRED).risky


def test_what_would_need_the_shield_is_risky_wherever_the_car_is() -> None:
    """By prediction neither clearance nor deviation counts by itself."""
    trigger = RiskTrigger(TriggerConfig(), 0.1)
    near, aside = replace(CLEAR, clearance=0.7), replace(CENTRED, lateral_offset=1.7)
    assert not trigger.update(near, aside, 4.0).risky
    assert trigger.update(CLEAR, CENTRED, 4.0, needs_shield=True).reasons == ("shield",)
    assert not RiskTrigger(PRINTED, 0.1).update(CLEAR, CENTRED, 4.0, needs_shield=True).risky


def test_a_car_that_does_not_get_on_needs_help() -> None:
    """After four seconds below the stall speed, until it drives again."""
    trigger = RiskTrigger(TriggerConfig(), 0.1)
    speeds = [0.0, 0.9, -0.5, 0.0] * 10 + [0.0]
    standing = [trigger.update(CLEAR, CENTRED, speed).reasons for speed in speeds]
    assert standing == [()] * 40 + [("stalled",)]
    assert trigger.update(CLEAR, CENTRED, 0.9).reasons == ("stalled",)
    assert trigger.update(CLEAR, CENTRED, 1.0).reasons == ("hold",)
    trigger.reset()
    assert not any(trigger.update(CLEAR, CENTRED, 0.0).risky for _ in range(40))


@pytest.mark.parametrize(
    ("config", "speed"), [(PRINTED, 0.0), (TriggerConfig(), math.inf), (TriggerConfig(), math.nan)]
)
def test_no_car_stalls_as_printed_or_whose_speed_is_not_known(
    config: TriggerConfig, speed: float
) -> None:
    """It may stand as long as it likes."""
    trigger = RiskTrigger(config, 0.1)
    assert not any(trigger.update(CLEAR, CENTRED, speed).risky for _ in range(100))


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
        ("lane_deviation", -1.0),
        ("lane_deviation", 0.2),
        ("form", "other"),
    ],
)
def test_impossible_thresholds_raise(field: str, value: Any) -> None:
    """Naming the field and the value."""
    with pytest.raises(InvalidLimits, match=f"`{field}`.*Got"):
        TriggerConfig(**{field: value})
    with pytest.raises(InvalidLimits, match="`dt`"):
        RiskTrigger(PRINTED, 0.0)
    with pytest.raises(InvalidLimits, match="`config`.*None"):
        RiskTrigger(None, 0.1)  # type: ignore[arg-type]


@pytest.mark.parametrize("centres", [(), (0.0, math.nan), 3.5, ((0.0,),)])
def test_impossible_lane_centres_raise(centres: Any) -> None:
    """Naming the argument and its value."""
    with pytest.raises(InvalidLimits, match="`lane_centres`.*Got"):
        RiskTrigger(PRINTED, 0.1, centres)
    with pytest.raises(InvalidProblem, match="`lane_centres`.*numbers"):
        RiskTrigger(PRINTED, 0.1, ("left",))  # type: ignore[arg-type]


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
        RiskTrigger(PRINTED, 0.1).update(*arguments)


def test_wider_lanes_have_other_centres() -> None:
    """The same offset is near the passing lane's centre, or between the lanes."""
    lane = replace(CENTRED, lateral_offset=4.9)
    risks = [
        RiskTrigger(PRINTED, 0.1, LaneGeometry(width).centres).update(CLEAR, lane)
        for width in (3.5, 5.0)
    ]
    assert [risk.risky for risk in risks] == [True, False]
