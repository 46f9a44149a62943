"""One home for each fact: who reads the car, the scanner and the lanes follows their change."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from expert.fsm import PASSING_LANE
from irl_dal.build import build_loop, supervision
from irl_dal.config import RunConfig, parse, to_mapping
from irl_dal.envs.road import LANES
from irl_dal.loop import ControlLoop
from irl_dal.planner.energy.clearance import scan_points
from shield import PredictiveFilter


@pytest.fixture
def empty(tmp_path: Path) -> RunConfig:
    """A straight empty road with nothing beside it in view of a short scanner."""
    road = tmp_path / "straight.csv"
    road.write_text("\n".join(f"{x},0,7,7" for x in range(0, 601, 5)))
    config = RunConfig()
    env = replace(config.env, track=str(road), route_length=300.0, lidar_range=2.0)
    return replace(config, env=env, planner=replace(config.planner, enabled=False))


def with_env(config: RunConfig, **changes: Any) -> RunConfig:
    """The configuration with another city."""
    return replace(config, env=replace(config.env, **changes))


def begin(config: RunConfig) -> tuple[ControlLoop, dict[str, Any]]:
    """A loop after its reset, and the `info`."""
    loop = build_loop(config, supervision(config, None))
    return loop, loop.reset(seed=0)[1]


@pytest.mark.parametrize("reach", [10.0, 15.0, 20.0, 60.0])
def test_the_range_is_everybody_s(empty: RunConfig, reach: float) -> None:
    """A beam without a return is none to world, clearance, expert, context and energies."""
    loop, info = begin(with_env(empty, lidar_range=reach, lidar_noise=0.0))
    far = np.full(loop.city.config.scanner.beams, reach)
    loop.world.reset()
    loop.world.update(far, 8.0, 0.0, info["lane"])
    assert len(loop.world.obstacles.points) == len(loop.world.frontier) == 0
    assert loop._clearance.update(far).clearance <= reach
    context = replace(info["context"], scan=far)
    assert len(scan_points(context)[0]) == 0
    assert context.scanner == loop.city.config.scanner
    loop._expert.reset()
    assert loop._expert.act(loop.world, info["lane"], np.zeros(2)).setpoint[1] > 5.0
    assert loop.observation_space["lidar"].high.max() == reach  # type: ignore[index]
    loop.close()


@pytest.mark.parametrize("beams", [45, 90, 360])
def test_any_number_of_beams_drives(empty: RunConfig, beams: int) -> None:
    """Observation, world, context and expert take the scanner's own number."""
    loop, info = begin(with_env(empty, lidar_beams=beams))
    observation, *_, info = loop.step(np.array([0.0, 0.3]))
    assert observation["lidar"].shape == (beams,)
    assert info["context"].encode().shape == (64,)
    assert loop.world.scanner.beams == beams
    loop.close()


def test_the_wheelbase_is_the_car_s_too(empty: RunConfig) -> None:
    """A longer car turns less at the same command, and the shield knows it."""
    rates = {}
    for wheelbase in (2.7, 3.2):
        loop, _ = begin(replace(empty, limits=replace(empty.limits, wheelbase=wheelbase)))
        for _ in range(10):
            info = loop.step(loop.limits.to_action(np.array([0.1, 3.0])))[-1]
        speed, yaw_rate = info["speed"], info["lateral_acceleration"] / info["speed"]
        rates[wheelbase] = yaw_rate / speed
        loop.close()
    assert rates[2.7] / rates[3.2] == pytest.approx(3.2 / 2.7, rel=0.02)


def test_the_outline_is_everybody_s(empty: RunConfig) -> None:
    """A bumper further forward moves the scanner, for the sensors and for those who read them."""
    vehicle = replace(empty.env.vehicle, length=5.5, front_bumper=4.4, width=2.2)
    loop, info = begin(with_env(empty, vehicle=vehicle))
    scanner = loop.city.config.scanner
    assert scanner.mount == 4.4 and info["context"].scanner == scanner
    assert loop.city._lidar._mount == 4.4
    assert loop.world.scanner == scanner and loop.world.vehicle == vehicle
    shield = loop.supervision.safety_filter
    assert isinstance(shield, PredictiveFilter)
    assert shield.geometry == vehicle and shield.world is loop.world
    assert info["context"].vehicle == vehicle == loop.city.scene().geometry
    car = loop.city._vehicle
    low, high = car._bullet.getAABB(car.body, -1)
    assert np.subtract(high, low)[:2] == pytest.approx([5.5, 2.2], abs=0.15)
    loop.close()


def test_the_keys_of_the_geometry_are_the_city_s() -> None:
    """One key for each number; none of them stands in a group of its users."""
    keys = to_mapping(RunConfig())
    assert keys["env"]["vehicle"] == {"length": 4.5, "width": 1.8, "front_bumper": 3.6}
    text = str({name: keys[name] for name in ("expert", "shield", "planner", "perception")})
    for name in ("max_range", "lane_width", "lane_centres", "wheelbase", "beams", "forward"):
        assert f"'{name}'" not in text, name
    changed = parse({"env": {"lidar_beams": 90, "vehicle": {"length": 5.0}}})
    assert changed.env.scanner.beams == 90 and changed.env.vehicle.length == 5.0


def test_the_lanes_are_everybody_s(empty: RunConfig) -> None:
    """Trigger, context and expert have the road's lane centres."""
    loop, info = begin(empty)
    assert tuple(loop._trigger._centres) == info["context"].lane_centres == LANES.centres
    assert PASSING_LANE == LANES.width
    loop.close()
    trigger = replace(empty.shield.trigger, passing_lane=False)
    loop, info = begin(replace(empty, shield=replace(empty.shield, trigger=trigger)))
    assert tuple(loop._trigger._centres) == info["context"].lane_centres == (0.0,)
    loop.close()
