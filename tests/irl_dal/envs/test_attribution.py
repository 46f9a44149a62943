"""Whose fault a contact or a departure is, staged one by one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from irl_dal.envs import FAULTS, CityConfig, CityEnv, FaultConfig
from irl_dal.envs.attribution import departs, keeps_a1
from irl_dal.envs.road import HOME_LANE, LANE_WIDTH, Road
from irl_dal.envs.traffic import BARREL, PEDESTRIAN, Crossing, Obstacle, Traffic
from irl_dal.envs.vehicle import VehicleState
from shield import Assumptions, VehicleGeometry

CAR = (4.4, 1.8, 1.5)
WALKER = (*PEDESTRIAN, 1.8)
DT = 0.1

Stage = Callable[..., list[dict[str, Any]]]


def standing(s: float, size: tuple[float, float, float] = CAR) -> Obstacle:
    """Something that stands in the ego's lane."""
    return Obstacle("car" if size is CAR else "barrel", size, s, HOME_LANE)


def walker(s: float, d: float = -8.0) -> Obstacle:
    """A person at the roadside."""
    return Obstacle("pedestrian", WALKER, s, d, crossing=Crossing(d, 8.0, 1.2, 35.0))


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Stage:
    """Drives with one body and held commands until something happens; `info` of each step."""

    def run(
        body: Obstacle, steering: float, speed: float, pace: float = 0.0, **fields: Any
    ) -> list[dict[str, Any]]:
        monkeypatch.setattr(Traffic, "_own_lane", lambda *_: [body])
        monkeypatch.setattr(Traffic, "_pedestrians", lambda *_: [])
        monkeypatch.setattr(Traffic, "_oncoming", lambda *_: [])
        monkeypatch.setattr(Traffic, "_follow", lambda *_: pace)
        monkeypatch.setattr(Crossing, "pace", lambda *_, **__: pace)
        env = CityEnv(lane_sensor="odometry", initial_speed=speed, **fields)
        env.camera_on = False
        _, info = env.reset(seed=0)
        assert (info["contact"], info["departure"], info["fault"]) == (False, False, None)
        infos: list[dict[str, Any]] = []
        while len(infos) < 100 and not (infos and infos[-1]["fault"]):
            infos.append(env.execute(np.array([steering, speed]))[-1])
        infos.append(env.execute(np.array([steering, speed]))[-1])
        env.close()
        return infos[:-1] if infos[-2]["fault"] is None else infos

    return run


@pytest.mark.parametrize("size", [CAR, BARREL])
def test_driving_into_what_stands_is_at_fault(stage: Stage, size: tuple[float, ...]) -> None:
    """The step on which the bodies touch has the verdict, no other."""
    infos = stage(standing(12.0, size), 0.0, 6.0)
    assert infos[-2]["fault"] == "at_fault" and infos[-2]["contact"] and infos[-2]["collision"]
    assert all(info["fault"] is None and not info["contact"] for info in infos[:-2])
    assert infos[-1]["fault"] is None
    assert not any(info["departure"] for info in infos)


def test_a_near_miss_is_a_collision_but_no_contact(stage: Stage) -> None:
    """`collision` counts a clearance below `collision_distance`, `contact` bodies that touch."""
    infos = stage(standing(12.0), 0.0, 4.0)
    near = [info for info in infos if info["collision"] and not info["contact"]]
    assert near and all(info["fault"] is None for info in near)


def test_a_standing_car_that_is_hit_is_at_rest(stage: Stage) -> None:
    """By a person at its side, by a car from behind."""
    assert stage(walker(2.0), 0.0, 0.0, pace=1.2)[-2]["fault"] == "at_rest"
    behind = Obstacle("car", CAR, -9.0, HOME_LANE, cruise=8.0, speed=8.0)
    assert stage(behind, 0.0, 0.0, pace=8.0)[-2]["fault"] == "at_rest"


def test_a_moving_car_that_is_hit_in_its_side_is_at_fault(stage: Stage) -> None:
    """People may walk into it: it has to stand by then."""
    assert stage(walker(4.5), 0.0, 1.0, pace=1.2)[-2]["fault"] == "at_fault"


def test_a_moving_car_that_is_hit_from_behind_is_not_at_fault(stage: Stage) -> None:
    """A faster body came from behind the rear bumper; a slower one has not run into it."""
    behind = Obstacle("car", CAR, -9.0, HOME_LANE, cruise=8.0, speed=8.0)
    assert stage(behind, 0.0, 3.0, pace=8.0)[-2]["fault"] == "hit_by_other"
    oncoming = Obstacle("car", CAR, 20.0, HOME_LANE, cruise=-3.0, speed=-3.0)
    assert stage(oncoming, 0.0, 3.0, pace=-3.0)[-2]["fault"] != "hit_by_other"


@pytest.mark.parametrize(
    ("pace", "quick", "body"),
    [
        (3.0, 100.0, walker(3.9)),
        (1.9, 100.0, walker(4.0)),
        (3.0, 1.0, walker(5.5, -10.0)),
    ],
)
def test_people_beyond_a1_are_named(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, pace: float, quick: float, body: Obstacle
) -> None:
    """Too fast, too sudden, or both."""
    monkeypatch.setattr("irl_dal.envs.traffic.STRIDE_ACCELERATION", quick)
    assert stage(body, 0.0, 1.0, pace=pace)[-2]["fault"] == "assumption:A1"


@pytest.mark.parametrize(
    ("fields", "verdict"),
    [
        ({}, "at_fault"),
        ({"lidar_noise": 0.1}, "assumption:A3"),
        ({"lidar_dropout": 0.3}, "at_fault"),
        ({"faults": FaultConfig(noise_bursts=1.0)}, "assumption:A3"),
        ({"faults": FAULTS["latency_1"]}, "assumption:A5"),
        ({"faults": FAULTS["actuator_lag"]}, "assumption:A6"),
        ({"faults": FAULTS["slow_servo"]}, "assumption:A6"),
        ({"faults": FAULTS["dead_beams"]}, "at_fault"),
        ({"faults": FAULTS["stuck_beams"]}, "at_fault"),
        ({"faults": FaultConfig(frozen_camera=1.0)}, "at_fault"),
    ],
)
def test_sensors_and_actuators_excuse_only_what_they_explain(
    stage: Stage, fields: dict[str, Any], verdict: str
) -> None:
    """Dead and stuck beams are the shield's work, and the camera sees no obstacles."""
    assert stage(standing(12.0), 0.0, 6.0, **fields)[-2]["fault"] == verdict


@pytest.mark.parametrize(
    ("fields", "verdict"),
    [
        ({}, "at_fault"),
        ({"faults": FaultConfig(frozen_camera=1.0)}, "assumption:A9"),
        ({"faults": FaultConfig(noise_bursts=1.0)}, "at_fault"),
        ({"faults": FAULTS["latency_2"]}, "assumption:A5"),
    ],
)
def test_a_departure_is_judged_on_its_first_step(
    stage: Stage, fields: dict[str, Any], verdict: str
) -> None:
    """With the rear axle still in the lanes: it is a corner that leaves them."""
    infos = stage(standing(200.0), 0.3, 4.0, **fields)
    assert infos[-2]["fault"] == verdict and infos[-2]["departure"] and not infos[-2]["contact"]
    assert infos[-1]["departure"] and infos[-1]["fault"] is None
    assert infos[-2]["lateral_offset"] < 1.5 * LANE_WIDTH - 0.9


@pytest.mark.parametrize(
    ("d", "yaw", "out"),
    [
        (-0.91, 0.0, False), (-0.89, 0.0, True), (-6.09, 0.0, False), (-6.11, 0.0, True),
        (-1.7, 0.2, False), (-1.5, 0.2, True), (-5.5, -0.2, True), (-5.2, 0.2, False),
    ],
)  # fmt: skip
def test_a_corner_decides(d: float, yaw: float, out: bool) -> None:
    """On a straight: half of the width is 0.9 m, the bumper 3.6 m ahead of the rear axle."""
    n = 200
    points = np.stack([0.5 * np.arange(n), np.zeros(n)], axis=1)
    road = Road(points, np.zeros(n), np.zeros(n), 60.0)
    state = VehicleState(x=50.0, y=d, yaw=yaw, speed=5.0, yaw_rate=0.0, lateral_speed=0.0)
    assert departs(road, state, road.locate(50.0, d), VehicleGeometry()) == out


def test_vehicles_stay_in_their_lane_and_go_its_way() -> None:
    """A1 of level P0; a standing car beside the middle of its lane keeps it."""
    still = np.zeros(2)
    car = Obstacle("car", CAR, 0.0, HOME_LANE)
    assert keeps_a1(car, np.array([8.0, 0.0]), still, DT)
    assert not keeps_a1(car, np.array([-1.0, 0.0]), still, DT)
    assert not keeps_a1(car, np.array([8.0, 0.5]), still, DT)
    assert keeps_a1(Obstacle("car", CAR, 0.0, HOME_LANE + 0.4), still, still, DT)
    assert not keeps_a1(Obstacle("car", CAR, 0.0, HOME_LANE + 1.0), still, still, DT)
    assert keeps_a1(Obstacle("car", CAR, 0.0, -HOME_LANE), np.array([-7.0, 0.0]), still, DT)


@pytest.mark.parametrize(
    "seeds", [range(2), pytest.param(range(2, 9), marks=pytest.mark.slow)], ids=["some", "more"]
)
@pytest.mark.parametrize("difficulty", ["paper", "hard"])
def test_the_default_traffic_keeps_every_assumption(difficulty: str, seeds: range) -> None:
    """Nobody walks or sets off faster than the shield counts on, vehicles keep their lane.

    The ego takes the passing lane, in which nothing is.
    """
    promised, walked, driven = Assumptions(), 0.0, 0
    env = CityEnv(CityConfig(difficulty=difficulty, lane_sensor="odometry"))
    assert 3.0 * env.config.lidar_noise <= promised.range_error
    assert env.config.faults == FaultConfig()
    env.camera_on = False
    for seed in seeds:
        _, info = env.reset(seed=seed)
        bodies = env.scene().obstacles
        places, before = np.array([(o.s, o.d) for o in bodies]), np.zeros((len(bodies), 2))
        people = np.array([o.kind != "car" for o in bodies])
        for _ in range(350):
            steering = 0.2 * (LANE_WIDTH - info["lateral_offset"]) - 0.8 * info["heading_error"]
            info = env.execute(np.array([np.clip(steering, -0.4, 0.4), 8.0]))[-1]
            assert info["fault"] is None or not info["fault"].startswith("assumption")
            now = np.array([(o.s, o.d) for o in bodies])
            velocity, places = (now - places) / DT, now
            pace, last = np.hypot(*velocity.T), np.hypot(*before.T)
            before = velocity
            assert (pace[people] <= promised.person_speed + 1e-6).all()
            assert (pace - last)[people].max(
                initial=0.0
            ) <= promised.person_acceleration * DT + 1e-6
            assert (velocity[~people, 1] == 0.0).all()
            assert all(keeps_a1(o, v, v, DT) for o, v in zip(bodies, velocity, strict=True))
            walked = max(walked, pace[people].max(initial=0.0))
            driven += int((pace[~people] > 1.0).any())
    env.close()
    assert walked > 1.0 and driven > 100
