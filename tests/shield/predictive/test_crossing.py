"""The car stops so far away that a person who crosses keeps the distance that it has left."""

import math

import pytest

from tests.shield.predictive.bodies import Thing, Walk
from tests.shield.predictive.filters import shared_filter
from tests.shield.predictive.kinematic_world import KinematicWorld

PERIODS = 60
ROOM = 1.5  # [m] from the bumper to the person's path


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("distance", [20.0, 24.0, 30.0])
def test_a_person_who_crosses_is_not_brushed_past(side: float, distance: float) -> None:
    """However the driver goes on: while the person is ahead there is room to the bumper."""
    person = Thing(distance, 3.5 * side, 0.5, motion=Walk([(0.0, -1.2 * side)]))
    world = KinematicWorld([person], speed=6.0)
    shield = shared_filter()
    shield.reset([0.0, world.speed])
    nearest = math.inf
    for step in range(PERIODS):
        shield.update(world.scan(), world.speed, world.yaw_rate, world.lane())
        world.advance(shield.filter([0.0, 6.0]).safe_action, step)
        body = world.body()
        cos, sin = math.cos(body.yaw), math.sin(body.yaw)
        dx, dy = person.x - world.pose[0], person.y - world.pose[1]
        ahead = cos * dx + sin * dy - world.geometry.front_bumper
        if abs(cos * dy - sin * dx) < 0.5 * world.geometry.width and ahead > -1.0:
            nearest = min(nearest, ahead - 0.5 * person.width)
    assert nearest > ROOM
