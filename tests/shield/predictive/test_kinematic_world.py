"""The kinematic world is exact: contacts, ranges, motion."""

import math

import numpy as np
import pytest

from shield import ScannerGeometry
from tests.shield.predictive.bodies import Chase, Road, Roll, Thing, Walk
from tests.shield.predictive.kinematic_world import KinematicWorld, cast

CAR = Thing(0.0, 0.0, 2.0, 4.0)


@pytest.mark.parametrize(
    ("thing", "touching"),
    [
        (Thing(2.5, 0.0, 1.0), True),
        (Thing(2.51, 0.0, 1.0), False),
        (Thing(2.5, 1.5, 1.4), False),
        (Thing(2.5, 1.5, 1.42), True),
        (Thing(4.0, 0.0, 2.0, 4.0), True),
        (Thing(4.01, 0.0, 2.0, 4.0), False),
        (Thing(3.4, 0.0, 2.0, 2.0, math.pi / 4), True),
        (Thing(3.42, 0.0, 2.0, 2.0, math.pi / 4), False),
        (Thing(0.0, 0.0, 0.1), True),
    ],
)
def test_contacts_are_exact(thing: Thing, touching: bool) -> None:
    """Discs and rectangles, at sides and at corners."""
    assert CAR.touches(thing) is touching


def test_ranges_are_exact() -> None:
    """A disc ahead, a rectangle to the left, and the nearer of two in line."""
    scanner = ScannerGeometry(beams=3, field_of_view=math.pi, max_range=40.0)
    things = [Thing(10.0, 0.0, 2.0), Thing(20.0, 0.0, 2.0), Thing(0.0, 6.0, 2.0, 3.0)]
    ranges, what = cast(scanner, (0.0, 0.0, 0.0), things)
    assert ranges == pytest.approx([math.inf, 9.0, 5.0]) and what.tolist() == [-1.0, 0.0, 2.0]
    ranges, _ = cast(scanner, (0.0, 0.0, math.pi / 2), things)
    assert ranges == pytest.approx([9.0, 5.0, math.inf])


@pytest.mark.parametrize("curvature", [0.0, 0.02, -0.02])
def test_a_road_places_and_locates(curvature: float) -> None:
    """One is the inverse of the other."""
    road = Road(curvature)
    for s, d in ((0.0, 0.0), (20.0, 3.5), (40.0, -1.0)):
        x, y, _ = road.place(s, d)
        (along,), (aside,) = road.locate(np.array([[x, y]]))
        assert (along, aside) == pytest.approx((s, d))


def test_the_car_drives_a_circle() -> None:
    """After a full turn at constant steering it is where it was."""
    world = KinematicWorld([], None, speed=2.0, steering=0.3, understeer=0.0)
    radius = world.limits.wheelbase / math.tan(0.3)
    periods = 2.0 * math.pi * radius / (2.0 * world.limits.dt)
    for step in range(round(periods)):
        world.advance(np.array([0.3, 2.0]), step)
    assert math.hypot(*world.pose[:2]) < 0.3
    assert world.pose[2] == pytest.approx(2.0 * math.pi, abs=0.05)


def test_people_and_vehicles_keep_their_limits() -> None:
    """Nobody is faster, or gets faster sooner, than the motions say; a vehicle brakes to rest."""
    road, car = Road(), Thing(50.0, 0.0, 1.8, 4.5)
    for motion in (Walk([(5.0, 0.0), (-5.0, 3.0)], hold=20), Chase()):
        person, last = Thing(0.0, 0.0, 0.5, motion=motion), np.zeros(2)
        for _ in range(80):
            person.x, person.y, _ = person.next_pose(car, 0.1)
            assert math.hypot(*person.velocity) <= 1.8 + 1e-9
            assert math.hypot(*(person.velocity - last)) <= 0.09 + 1e-9
            last = person.velocity
    truck = Thing(0.0, 0.0, 1.8, 4.5, motion=Roll(road, 7.0, 0.0, brake_at=0))
    for _ in range(10):
        truck.x, truck.y, truck.yaw = truck.next_pose(car, 0.1)
    assert truck.x == pytest.approx(3.5) and not truck.velocity.any()


def test_events_tell_who_hit_whom() -> None:
    """Driving into a wall is the car's fault; standing is not, nor being hit from behind."""
    ahead = KinematicWorld([Thing(6.0, 0.0, 1.0)], speed=5.0)
    events = [event for step in range(10) for event in ahead.advance(np.array([0.0, 5.0]), step)]
    assert events and events[0].at_fault and events[0].thing == 0
    person = Thing(2.0, 1.5, 0.5, motion=Chase(), velocity=np.array([0.0, -1.0]))
    still = KinematicWorld([person])
    events = [event for step in range(20) for event in still.advance(np.zeros(2), step)]
    assert events and not any(event.at_fault for event in events)
    behind = Thing(-4.0, 0.0, 1.0, velocity=np.array([9.0, 0.0]))
    behind.motion = Walk([(9.0, 0.0)])
    behind.motion.advance = lambda thing, car, dt: (thing.x + 0.9, thing.y, 0.0)  # type: ignore[method-assign]
    slow = KinematicWorld([behind], speed=2.0)
    events = [event for step in range(10) for event in slow.advance(np.array([0.0, 2.0]), step)]
    assert events and events[0].by_other and not events[0].at_fault


def test_leaving_the_lanes_is_an_event() -> None:
    """As soon as a corner is out, by exact geometry."""
    world = KinematicWorld([], pose=(0.0, -0.8, 0.0), speed=3.0)
    assert world.outside() == pytest.approx(-0.05)
    events = [event for step in range(5) for event in world.advance(np.array([-0.3, 3.0]), step)]
    assert events and events[0].thing == -1 and events[0].at_fault
