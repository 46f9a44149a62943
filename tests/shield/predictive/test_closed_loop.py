"""Whoever drives: while the car moves it touches nothing, and its body stays within the lanes."""

from tests.shield.predictive.filters import robot_filter, shared_filter
from tests.shield.predictive.kinematic_world import Driver, KinematicWorld, drive
from tests.shield.predictive.scenes import drivers, roads, yards
from tests.shield.tiers import two_tiers


@two_tiers(fast=8, slow=5_000, world=roads(), driver=drivers())
def test_on_the_road(world: KinematicWorld, driver: Driver) -> None:
    """P0: things, people and vehicles that keep their lanes; any wishes."""
    assert drive(world, shared_filter(), driver, 100).faults == []


@two_tiers(fast=4, slow=2_500, world=roads(), driver=drivers())
def test_on_the_road_where_everything_moves(world: KinematicWorld, driver: Driver) -> None:
    """P1: the same world."""
    assert drive(world, shared_filter(level="P1"), driver, 100).faults == []


@two_tiers(fast=8, slow=2_500, world=yards(), driver=drivers(fastest=3.0))
def test_without_lanes(world: KinematicWorld, driver: Driver) -> None:
    """A small robot with a 270 degree scanner among things and people."""
    assert drive(world, robot_filter(270), driver, 100).faults == []
