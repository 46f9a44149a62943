"""What is foreseen is what the shield would do."""

import numpy as np
import pytest

from shield import Outlook, World
from tests.shield.predictive.bodies import Array, Thing
from tests.shield.predictive.filters import shared_filter
from tests.shield.predictive.kinematic_world import KinematicWorld

PERIODS = 8


def seen(things: list[Thing], speed: float) -> World:
    """The world of a car in its lane among things, after some scans."""
    scene = KinematicWorld(things, speed=speed)
    shield = shared_filter()
    shield.reset([0.0, speed])
    for _ in range(5):
        shield.update(scene.scan(), scene.speed, scene.yaw_rate, scene.lane())
        scene.advance(np.array([0.0, speed]), 0)
    return shield.world


def refusal(world: World, commands: Array) -> str:
    """Of commands from where the car drives straight on."""
    shield = shared_filter()
    outlook = Outlook(shield.limits, shield.geometry, shield.assumptions)
    return outlook.refusal(world, commands, np.array([0.0, world.speed]))


def going_on(steering: float, speed: float) -> Array:
    """The same command in each period."""
    return np.tile([steering, speed], (PERIODS, 1))


@pytest.mark.parametrize(
    ("distance", "foreseen"), [(40.0, ""), (16.0, "would stop too near"), (12.0, "would pass")]
)
def test_a_wall_is_foreseen_where_going_on_leaves_no_room_to_stop(
    distance: float, foreseen: str
) -> None:
    """From 6 m/s in 0.8 s and with the brakes; the wall is across both lanes."""
    reason = refusal(seen([Thing(distance, 1.75, 12.0, 0.5)], 6.0), going_on(0.0, 6.0))
    assert reason.startswith(foreseen) and bool(reason) == bool(foreseen)


def test_a_driver_that_brakes_needs_no_shield() -> None:
    """Before the same wall, where going on would need it."""
    world = seen([Thing(16.0, 1.75, 12.0, 0.5)], 6.0)
    braking = np.stack([np.zeros(PERIODS), 6.0 - 0.5 * np.arange(1, PERIODS + 1)], axis=1)
    assert refusal(world, braking) == ""


def test_wheels_that_lead_out_of_the_lanes_are_foreseen() -> None:
    """To the right, where no lane is; to the left there is one."""
    world = seen([], 6.0)
    assert "leave the lanes" in refusal(world, going_on(-0.12, 6.0))
    assert refusal(world, going_on(0.03, 6.0)) == ""


def test_without_a_lane_nothing_is_certain() -> None:
    """Wherever the commands lead."""
    world = seen([], 6.0)
    world.corridor = None
    assert refusal(world, going_on(0.0, 6.0)) == "needs a lane, and the lane is lost"
