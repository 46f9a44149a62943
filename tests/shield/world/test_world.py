"""What is around the car: kept through dropouts and out of view, moving as it was seen to move."""

import math
from dataclasses import replace

import numpy as np
import pytest

from shield import LaneGeometry, ScannerGeometry, VehicleGeometry, World
from shield.world import Corridor, Kind, Obstacles
from shield.world.world import LEAST_KNOWN, Index
from tests.shield.predictive.bodies import Array, Road, Roll, Thing, Walk
from tests.shield.predictive.kinematic_world import KinematicWorld

SILENT = np.full(180, np.nan)


def world_for(scene: KinematicWorld) -> World:
    """A world that has seen nothing yet."""
    lanes = None if scene.road is None else scene.road.lanes
    return World(scene.limits.dt, scene.scanner, scene.geometry, lanes)


def watch(scene: KinematicWorld, world: World, periods: int, scan: Array | None = None) -> None:
    """Let the car drive on as it does, and the world see it."""
    for step in range(periods):
        ranges = scene.scan() if scan is None else scan
        world.update(ranges, scene.speed, scene.yaw_rate, scene.lane())
        scene.advance(np.array([scene.steering, scene.speed]), step)


def velocities(world: World, kind: Kind) -> Array:
    """Of the hits of a kind that are in the newest scan (n, 2) [m/s]."""
    seen = (world.obstacles.kind == kind) & (world.obstacles.age == 0.0)
    return world.obstacles.velocity[seen]


def kinds_at(scene: KinematicWorld, world: World, thing: Thing) -> Index:
    """Kinds of the hits of a thing, for a car that drives straight on."""
    near = np.hypot(*(world.obstacles.points - [thing.x - scene.pose[0], thing.y]).T) < 0.5
    assert near.any()
    return world.obstacles.kind[near]


def test_before_the_first_scan_all_is_unknown() -> None:
    """Unknown space begins right before the scanner, in every direction."""
    world = world_for(KinematicWorld([]))
    assert len(world.frontier) == 180 and not len(world.obstacles.points)
    assert np.hypot(*(world.frontier - [3.6, 0.0]).T) == pytest.approx(LEAST_KNOWN)
    assert world.corridor is None


def test_a_scan_of_a_free_road_leaves_nothing_unknown() -> None:
    """No hits, no frontier, and a corridor."""
    scene = KinematicWorld([], speed=5.0)
    world = world_for(scene)
    watch(scene, world, 1)
    assert not len(world.frontier) and not len(world.obstacles.points)
    assert world.corridor is not None and world.flags == ()
    assert (world.corridor.right, world.corridor.left) == (-1.75, 5.25)


@pytest.mark.parametrize("missing", [math.nan, 40.0, 0.0])
def test_a_dropout_of_its_beams_keeps_an_obstacle(missing: float) -> None:
    """For two scans."""
    scene = KinematicWorld([Thing(15.0, 0.0, 0.5)], speed=1.0, rng=np.random.default_rng(0))
    world = world_for(scene)
    watch(scene, world, 8)
    for _ in range(2):
        scan = scene.scan()
        scan[scan < 39.0] = missing
        world.update(scan, scene.speed, 0.0, scene.lane())
        scene.advance(np.array([0.0, scene.speed]), 0)
        there = np.hypot(*(world.obstacles.points - [15.0 - scene.pose[0], 0.0]).T) < 0.7
        assert there.any()


def test_a_dead_beam_keeps_what_it_saw() -> None:
    """It says nothing, so a post behind it is remembered where it is."""
    scene = KinematicWorld([Thing(20.0, 0.0, 0.5)], speed=3.0)
    world = world_for(scene)
    watch(scene, world, 6)
    for _ in range(10):
        scan = scene.scan()
        scan[scan < 39.0] = np.nan
        world.update(scan, scene.speed, 0.0, scene.lane())
        scene.advance(np.array([0.0, scene.speed]), 0)
    (ahead, aside) = world.obstacles.points.mean(axis=0)
    assert ahead == pytest.approx(20.0 - 0.25 - scene.pose[0] + 0.3, abs=0.2)
    assert aside == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("pace", [0.0, 3.0, 6.0])
@pytest.mark.parametrize("own", [3.0, 8.0])
@pytest.mark.parametrize("curvature", [0.0, 0.015])
def test_the_velocity_of_a_car_is_that_of_its_rear(
    pace: float, own: float, curvature: float
) -> None:
    """Standing or driving, ahead or in the next lane: within the deviation, along the road."""
    road = Road(curvature)
    for offset in (0.0, 3.5):
        x, y, yaw = road.place(25.0, offset)
        motion = Roll(road, pace, offset)
        motion.deceleration = 1e-9  # it drives on whatever is ahead
        car = Thing(x, y, 1.8, 4.5, yaw, motion, pace * np.array([math.cos(yaw), math.sin(yaw)]))
        scene = KinematicWorld([car], road, speed=own, rng=np.random.default_rng(1))
        scene.steering = math.atan(2.7 * curvature)
        world = world_for(scene)
        watch(scene, world, 15)
        seen = velocities(world, Kind.VEHICLE)
        assert len(seen)
        speed = np.hypot(*seen.T)
        assert abs(float(np.median(speed)) - pace) < 0.4  # along the first lane
        if pace > 1.0:
            heading = car.yaw - scene.pose[2]
            direction = np.arctan2(seen[:, 1], seen[:, 0])
            assert float(np.median(direction)) == pytest.approx(heading, abs=0.12)


@pytest.mark.xfail(strict=True, reason="single hits of a flank move along it with the beams")
def test_no_hit_of_a_standing_car_seems_to_move() -> None:
    """Also those of its flank, which few beams see from behind."""
    scene = KinematicWorld([Thing(25.0, 3.5, 1.8, 4.5)], speed=8.0, rng=np.random.default_rng(1))
    world = world_for(scene)
    watch(scene, world, 15)
    seen = velocities(world, Kind.VEHICLE)
    assert len(seen) and np.hypot(*seen.T).max() < 0.6


def test_a_person_who_walks_is_seen_to_walk() -> None:
    """Within the deviation that is stated."""
    walk = Walk([(0.0, -1.3)], hold=300)
    person = Thing(20.0, 5.0, 0.5, motion=walk, velocity=np.array([0.0, -1.3]))
    scene = KinematicWorld([person], speed=4.0)
    world = world_for(scene)
    watch(scene, world, 12)
    seen = velocities(world, Kind.PERSON)
    assert len(seen) and np.abs(seen - [0.0, -1.3]).max() < 0.3


def test_who_leaves_a_parked_car_is_a_person_again() -> None:
    """Beside it both were one cluster, as wide as a car; what is then seen apart is narrow."""
    parked = Thing(10.7, 3.5, 1.8, 4.5)
    person = Thing(13.4, 1.9, 0.5, motion=Walk([(-1.6, -0.5)], hold=60))
    scene = KinematicWorld([parked, person], speed=1.0)
    world = world_for(scene)
    watch(scene, world, 20)
    assert (kinds_at(scene, world, person) == Kind.PERSON).all()


def test_a_person_who_goes_along_a_parked_car_and_on_is_no_rolling_vehicle() -> None:
    """A narrow piece of something wide that has moved by itself is a person."""
    parked = Thing(15.0, 3.5, 1.8, 4.5)
    person = Thing(14.5, 2.1, 0.5, motion=Walk([(-1.5, 0.0)], hold=60))
    scene = KinematicWorld([parked, person], speed=1.0, rng=np.random.default_rng(0))
    world = world_for(scene)
    watch(scene, world, 25)
    assert (kinds_at(scene, world, person) == Kind.PERSON).all()


def test_people_walk_on_while_the_scanner_is_silent() -> None:
    """At their velocity, as the same obstacle."""
    walk = Walk([(0.0, -1.3)], hold=300)
    person = Thing(22.0, 4.5, 0.5, motion=walk, velocity=np.array([0.0, -1.3]))
    scene = KinematicWorld([person], speed=4.0)
    world = world_for(scene)
    watch(scene, world, 10)
    before, number = world.obstacles.points.mean(axis=0), world.obstacles.number[0]
    watch(scene, world, 3, SILENT)
    moved = world.obstacles.points.mean(axis=0) - before
    assert moved == pytest.approx([-1.2, -0.39], abs=0.15)
    assert world.obstacles.number[0] == number


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_is_beside_the_car_is_remembered(side: float) -> None:
    """Where it is, though no beam reaches it; left behind, it is forgotten."""
    scene = KinematicWorld(
        [Thing(15.0, 2.4 * side, 1.8, 4.5)], speed=4.0, rng=np.random.default_rng(0)
    )
    world = world_for(scene)
    while scene.pose[0] < 14.0:
        watch(scene, world, 1)
    points = world.obstacles.points
    assert (scene.scan() > 39.0).all() and len(points) > 10
    aside = side * points[:, 1]
    assert aside.min() == pytest.approx(1.5, abs=0.15)
    assert points[:, 0].max() > 2.0
    while scene.pose[0] < 25.0:
        watch(scene, world, 1)
    assert not len(world.obstacles.points)


def test_who_has_gone_out_of_view_may_still_stand_there() -> None:
    """After the time in which a person could be anywhere, and however long a car stands."""
    post = Thing(8.0, -1.6, 0.5)
    scene = KinematicWorld([post], speed=2.0)
    world = world_for(scene)
    while scene.pose[0] < 5.5:
        watch(scene, world, 1)
    scene.speed = 0.0
    watch(scene, world, 300)
    assert (kinds_at(scene, world, post) == Kind.GONE).all()
    world.obstacles.points[:] = (1.0, 0.5)  # errors of odometry: under the car nothing stands
    watch(scene, world, 1)
    assert not len(world.obstacles.points)


def test_unknown_space_comes_nearer_and_goes_with_the_first_scan() -> None:
    """By the car's own speed and that of what may come."""
    scene = KinematicWorld([], speed=4.0)
    world = world_for(scene)
    watch(scene, world, 3)
    distances = []
    for _ in range(80):
        watch(scene, world, 1, SILENT)
        distances.append(float(np.hypot(*(world.frontier - [3.6, 0.0]).T).min()))
    assert -np.diff(distances[:30]) == pytest.approx(0.9)
    assert distances[-1] == pytest.approx(LEAST_KNOWN) and "scanner blind" in world.flags
    watch(scene, world, 1)
    assert not len(world.frontier) and world.flags == ()


def test_a_frozen_scanner_is_flagged() -> None:
    """Only while the car drives."""
    for speed, flagged in ((5.0, True), (0.0, False)):
        scene = KinematicWorld([Thing(30.0, 0.0, 2.0, 1.0)], speed=speed)
        world = world_for(scene)
        scan = scene.scan()
        watch(scene, world, 10, scan)
        assert ("scanner frozen" in world.flags) == flagged


def test_without_lanes_there_is_no_corridor_and_none_is_missed() -> None:
    """Also when a lane estimate is handed in."""
    scene = KinematicWorld([Thing(10.0, 0.0, 1.0)], None)
    world = world_for(scene)
    world.update(scene.scan(), 0.0, 0.0, KinematicWorld([]).lane())
    assert world.corridor is None and world.flags == ()


def test_a_reset_forgets_everything() -> None:
    """As new."""
    scene = KinematicWorld([Thing(10.0, 0.0, 1.0)], speed=2.0)
    world = world_for(scene)
    watch(scene, world, 5)
    world.reset()
    assert not len(world.obstacles.points) and len(world.frontier) == 180
    assert world.corridor is None and world.speed == 0.0


def test_obstacles_are_chosen_and_joined() -> None:
    """Row by row."""
    world = World(0.1, ScannerGeometry(), VehicleGeometry(), LaneGeometry())
    scene = KinematicWorld([Thing(10.0, 0.0, 2.0, 1.0)])
    world.update(scene.scan(), 0.0, 0.0, scene.lane())
    known = world.obstacles
    first = known.where(np.arange(len(known.points)) == 0)
    assert len(first.points) == 1 and len(Obstacles.none().joined(first).points) == 1
    assert np.array_equal(known.joined(first).points[-1], first.points[0])


@pytest.mark.parametrize("curvature", [0.0, 0.02, -0.03])
@pytest.mark.parametrize("offset", [0.0, 3.0])
def test_the_corridor_locates_points_in_the_lane(curvature: float, offset: float) -> None:
    """As the road does, and directions follow its bend."""
    road = Road(curvature)
    scene = KinematicWorld([], road, road.place(20.0, offset))
    corridor = Corridor.around(scene.lane(), road.lanes)
    assert corridor is not None
    x, y, yaw = scene.pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    for s, d in ((30.0, 0.0), (40.0, 5.0), (22.0, -1.0)):
        px, py, direction = road.place(s, d)
        dx, dy = px - x, py - y
        point = np.array([[cos * dx + sin * dy, cos * dy - sin * dx]])
        (along,), (aside,) = corridor.locate(point)
        assert (along, aside) == pytest.approx((s - 20.0, d), abs=1e-3)
        (way,) = corridor.direction(np.array([s - 20.0]))
        assert way == pytest.approx([math.cos(direction - yaw), math.sin(direction - yaw)])
    assert corridor.curvature_at(np.array([10.0])) == pytest.approx([curvature])
    assert corridor.advance(1.0) == pytest.approx(1.0 / (1.0 - curvature * offset))


def test_a_lost_lane_is_no_corridor() -> None:
    """None, one that was never seen, or one whose deviation is that of a lane's width."""
    lane = KinematicWorld([]).lane()
    assert lane is not None
    assert Corridor.around(None, LaneGeometry()) is None
    for lost in (replace(lane, age=math.inf), replace(lane, offset_std=3.5)):
        assert Corridor.around(lost, LaneGeometry()) is None
    old = Corridor.around(replace(lane, valid=False, offset_std=0.3), LaneGeometry())
    assert old is not None and old.std == 0.3
