"""Reward terms point where they should."""

from dataclasses import replace

import pytest

from expert import Mode
from irl_dal.envs.reward import RewardConfig, Situation, driving_mode, reward_terms

CALM = Situation(
    mode=Mode.LANE_FOLLOWING,
    lateral_offset=0.0,
    speed=8.0,
    clearance=20.0,
    steering_rate=0.0,
    collision=False,
    off_road=False,
    success=False,
)


def total(now: Situation) -> float:
    return sum(reward_terms(RewardConfig(), now).values())


def test_a_calm_step_is_worth_about_one() -> None:
    """The scale that `w_irl` refers to."""
    assert total(CALM) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "change",
    [
        {"lateral_offset": 0.8},
        {"speed": 2.0},
        {"clearance": 1.2},
        {"steering_rate": 0.6},
        {"collision": True},
        {"off_road": True},
    ],
)
def test_every_fault_costs(change: dict[str, object]) -> None:
    """Each departure from the calm step lowers the reward."""
    assert total(replace(CALM, **change)) < total(CALM) - 0.01


def test_the_mode_decides_which_lane_is_right() -> None:
    """The passing lane is wrong on a free road and right beside an obstacle."""
    passing = replace(CALM, lateral_offset=3.5)
    assert total(passing) < total(CALM)
    assert total(replace(passing, mode=Mode.DRIVING_STRAIGHT)) == pytest.approx(total(CALM))


def test_driving_mode_has_four_answers() -> None:
    """Lane and gap decide."""
    assert driving_mode(0.0, 100.0) is Mode.LANE_FOLLOWING
    assert driving_mode(0.0, 15.0) is Mode.OBSTACLE_AVOIDANCE
    assert driving_mode(3.4, 5.0) is Mode.DRIVING_STRAIGHT
    assert driving_mode(2.5, 90.0) is Mode.RETURNING
