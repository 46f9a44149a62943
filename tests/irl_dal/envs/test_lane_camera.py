"""The lane is measured in the image, and what cannot be measured is not claimed."""

import numpy as np
import pytest

from irl_dal.config import RunConfig
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.lane_camera import LaneCamera
from irl_dal.envs.road import HOME_LANE
from irl_dal.evaluation.rig import AgentSpec, Rig
from shield import LaneMeasurement


def look(brightness: float, seed: int) -> list[tuple[LaneMeasurement | None, float, float]]:
    """Measurements at random poses of one road with the true offset and heading error."""
    config = CityConfig(min_brightness=brightness, max_brightness=brightness, difficulty="easy")
    env = CityEnv(config)
    env.reset(seed=seed)
    road, rng = env.scene().road, np.random.default_rng(seed)
    seen = []
    for s in np.arange(10.0, 200.0, 12.0):
        offset, heading = rng.choice([0.0, 3.5]) + rng.normal(0.0, 0.3), rng.normal(0.0, 0.06)
        x, y, yaw = road.pose(float(s), HOME_LANE + offset)
        env._vehicle.place(x, y, yaw + heading, 0.0)
        env._sense()
        env._lane_camera.reset()
        env._observe()
        seen.append((env._lane, offset, heading))
    env.close()
    return seen


@pytest.mark.parametrize(("brightness", "bound"), [(1.0, 0.2), (0.0, 0.25)])
def test_single_images_give_offset_and_heading(brightness: float, bound: float) -> None:
    """Without any memory, by day and in the dark, four in five images and none far off."""
    seen = [row for seed in (1, 2, 3) for row in look(brightness, seed)]
    found = [(m, e, h) for m, e, h in seen if m is not None]
    assert len(found) > 0.8 * len(seen)
    errors = np.array([(m.lateral_offset - e, m.heading_error - h) for m, e, h in found])
    assert np.sqrt((errors[:, 0] ** 2).mean()) < bound
    assert np.abs(errors[:, 0]).max() < 0.8
    assert np.sqrt((errors[:, 1] ** 2).mean()) < 0.06


def test_reported_deviation_is_honest() -> None:
    """Errors in units of the reported deviation are about one."""
    found = [(m, e) for seed in (4, 5) for m, e, _ in look(0.8, seed) if m is not None]
    ratio = np.array([(m.lateral_offset - e) / m.offset_std for m, e in found])
    assert 0.3 < np.sqrt((ratio**2).mean()) < 1.8


@pytest.mark.parametrize("value", [0, 3, 120, 255])
def test_an_image_without_lines_gives_nothing(value: int) -> None:
    """Darkness, fog and a blinded camera are no lane."""
    camera = LaneCamera(64, 0.1)
    image = np.full((64, 64, 3), value, np.uint8)
    assert camera.measure(image, 5.0, 0.0) is None


def test_noise_is_no_lane() -> None:
    """Random pixels of every colour are not taken for lines with confidence."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        camera = LaneCamera(64, 0.1)
        image = rng.integers(0, 255, (64, 64, 3)).astype(np.uint8)
        assert camera.measure(image, 5.0, 0.0) is None


def test_a_frozen_image_gives_nothing() -> None:
    """An image that repeats itself bit by bit is an old one."""
    env = CityEnv()
    observation, info = env.reset(seed=3)
    assert info["lane_measurement"] is not None
    assert env._lane_camera.measure(observation["image"], 5.0, 0.0) is None
    env.close()


def test_measurement_belongs_to_the_state_in_info() -> None:
    """Measured offset and true offset of one `info` are of one moment, also in a swerve."""
    env = CityEnv(CityConfig(lane_sensor="odometry", lane_offset_noise=0.0))
    env.camera_on = False
    env.reset(seed=3)
    seen = 0
    for k in range(25):
        *_, info = env.execute(np.array([0.15 if k < 12 else -0.1, 6.0]))
        lane = info["lane_measurement"]
        seen += lane is not None
        assert lane is None or lane.lateral_offset == pytest.approx(info["lateral_offset"])
    env.close()
    assert seen > 20


def test_lines_that_have_gone_out_of_view_keep_the_pose() -> None:
    """The car's pose is not extrapolated from the nearest pixels, five metres ahead."""
    loop = Rig.build(RunConfig(), AgentSpec("expert")).loop
    loop.reset(seed=51002)
    errors = []
    for _ in range(250):
        *_, info = loop.step_expert()
        errors.append(info["lane"].lateral_offset - info["lateral_offset"])
    loop.close()
    assert np.abs(errors).max() < 0.15
