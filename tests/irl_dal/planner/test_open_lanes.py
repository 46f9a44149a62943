"""A plan is pulled to lanes that are free, and a standing car is not kept standing."""

from dataclasses import replace

import numpy as np
import pytest

from irl_dal.planner import EnergyConfig
from irl_dal.planner.energy.lane import LaneEnergy, open_lanes
from irl_dal.planner.energy.smoothness import StabilityEnergy
from tests.irl_dal.planner.scenes import (
    BEAM_ANGLES,
    HORIZON,
    LIMITS,
    MAX_RANGE,
    lane,
    open_road,
    scan_of,
)

STRAIGHT = lane(lateral_offset=0.0, heading_error=0.0, curvature=0.0, curvature_rate=0.0)


def ahead(distance: float, offset: float) -> np.ndarray:
    """A car's back `distance` m ahead of the LiDAR, `offset` m to the left."""
    return scan_of(float(np.arctan2(offset, distance)), float(np.hypot(distance, offset)), 1.6)


@pytest.mark.parametrize(
    ("scan", "expected"),
    [
        (np.full(len(BEAM_ANGLES), MAX_RANGE), (0.0, 3.5)),
        (ahead(12.0, 0.0), (3.5,)),
        (ahead(12.0, 3.5), (0.0,)),
        (ahead(34.0, 0.0), (0.0, 3.5)),
        (np.minimum(ahead(8.0, 0.0), ahead(15.0, 3.5)), (3.5,)),
        (np.minimum(ahead(15.0, 0.0), ahead(8.0, 3.5)), (0.0,)),
    ],
)
def test_a_blocked_lane_is_not_open(scan: np.ndarray, expected: tuple[float, ...]) -> None:
    """Open is what is free for a while; where nothing is, the freest lane."""
    assert open_lanes(open_road(lane=STRAIGHT, scan=scan)) == expected


def test_without_a_lane_estimate_every_lane_is_open() -> None:
    """Nobody knows in which lane a point lies."""
    blind = open_road(lane=lane(valid=False), scan=ahead(5.0, 0.0))
    assert open_lanes(blind) == blind.lane_centres


def lane_energy(scene, steering: float) -> float:  # type: ignore[no-untyped-def]
    """E_lane of one constant steering [rad] at the scene's speed."""
    action = LIMITS.to_action(np.array([steering, scene.speed]))
    plan = np.tile(action, (1, HORIZON, 1))
    return float(LaneEnergy(scene, EnergyConfig(), LIMITS, HORIZON).evaluate(plan)[0][0])


def test_a_car_between_the_lanes_is_pulled_to_the_open_one() -> None:
    """Nearer to the passing lane: with both open on to it, with an oncoming car there back home."""
    between = open_road(lane=replace(STRAIGHT, lateral_offset=2.2))
    back = replace(between, scan=ahead(18.0, 3.5 - 2.2))
    assert lane_energy(between, 0.04) < lane_energy(between, -0.04)
    assert lane_energy(back, 0.04) > lane_energy(back, -0.04)


def test_a_standing_car_is_not_kept_standing() -> None:
    """The reference speed of E_stability is not below `slowest_reference`."""
    stands = open_road(previous=np.zeros(2), speed=0.0)

    def planned(slowest: float) -> float:
        energy = EnergyConfig(slowest_reference=slowest, lane_weight=0.0)
        term = StabilityEnergy(stands, energy, LIMITS, HORIZON)
        slow, fast = (
            np.tile(LIMITS.to_action(np.array([0.0, speed])), (1, HORIZON, 1))
            for speed in (0.0, 3.0)
        )
        return float(term.evaluate(fast)[0][0] - term.evaluate(slow)[0][0])

    assert planned(3.0) < 0.0 < planned(0.0)


def test_the_slowest_reference_is_judged() -> None:
    """A negative one is refused by name."""
    with pytest.raises(ValueError, match="`slowest_reference`.*-1"):
        EnergyConfig(slowest_reference=-1.0)
