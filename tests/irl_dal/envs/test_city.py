"""The city keeps gymnasium's contract, is reproducible, and ends episodes as it says."""

import math
import warnings
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from irl_dal.config import ConfigError, RunConfig, parse, to_mapping
from irl_dal.envs import CITY_ID, CityConfig, CityEnv, FaultConfig, RewardConfig
from shield import ActuatorLimits

STRAIGHT = np.array([0.0, 0.2])


@pytest.fixture
def env() -> Iterator[CityEnv]:
    env = CityEnv()
    yield env
    env.close()


def drive(env: CityEnv, seed: int, steps: int) -> list[np.ndarray]:
    """Poses of a drive with steering drawn from a generator."""
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=seed)
    seen = [observation["image"], observation["lidar"], info["pose"]]
    for _ in range(steps):
        observation, _, terminated, truncated, info = env.step(rng.uniform(-0.1, 0.3, 2))
        seen += [observation["image"], observation["lidar"], info["pose"]]
        if terminated or truncated:
            break
    return seen


def test_checkers_pass_without_a_warning() -> None:
    """Both gymnasium's and stable-baselines3's checkers are silent."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(CITY_ID, render_mode="rgb_array")
        check_env(env.unwrapped)
        sb3_check_env(env.unwrapped)
        env.close()


def test_same_seed_same_trajectory(env: CityEnv) -> None:
    """Images, scans and poses repeat bit for bit, also after another episode in between."""
    one = drive(env, 5, 40)
    drive(env, 6, 15)
    two = drive(env, 5, 40)
    assert len(one) == len(two) > 60
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


def test_two_environments_do_not_disturb_each_other(env: CityEnv) -> None:
    """Interleaved with another environment the trajectory is the same as alone."""
    alone = drive(env, 5, 20)
    other = CityEnv()
    other.reset(seed=9)
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=5)
    together = [observation["image"], observation["lidar"], info["pose"]]
    for _ in range(20):
        other.step(STRAIGHT)
        observation, _, _, _, info = env.step(rng.uniform(-0.1, 0.3, 2))
        together += [observation["image"], observation["lidar"], info["pose"]]
    other.close()
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


def test_camera_off_changes_nothing_else(env: CityEnv) -> None:
    """Without images the scans and poses are the same: replaying a drive is exact and fast."""
    seen = drive(env, 5, 20)
    env.camera_on = False
    blind = drive(env, 5, 20)
    assert all(np.array_equal(a, b) for a, b in zip(seen[1::3], blind[1::3], strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(seen[2::3], blind[2::3], strict=True))


def test_reward_is_the_sum_of_its_named_terms(env: CityEnv) -> None:
    """`info["reward_terms"]` adds up to the reward."""
    env.reset(seed=1)
    for _ in range(10):
        _, reward, _, _, info = env.step(STRAIGHT)
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
        assert set(info["reward_terms"]) >= {"progress", "centring", "clearance", "collision"}


def test_driving_into_the_first_obstacle_is_a_collision(env: CityEnv) -> None:
    """A car that keeps its lane and never brakes ends with a collision, once, and terminated."""
    from expert.lateral import steer

    _, info = env.reset(seed=3)
    collided, steering = False, 0.0
    for _ in range(400):
        lane = info["lane_measurement"]
        if lane is not None:
            steering = steer(lane, 0.0, info["speed"], steering, env.limits)
        _, _, terminated, _, info = env.execute(np.array([steering, 6.0]))
        if terminated:
            collided = info["collision"]
            break
    assert collided and not info["success"]
    assert info["reward_terms"]["collision"] < 0.0


def test_leaving_the_road_ends_the_episode(env: CityEnv) -> None:
    """Full right lock leaves the road; that is no success and no time-out."""
    env.reset(seed=2)
    for _ in range(100):
        _, _, terminated, truncated, info = env.step(np.array([-1.0, -0.3]))
        if terminated or truncated:
            break
    assert terminated and info["off_road"] and not info["success"]


def test_standing_still_runs_out_of_time() -> None:
    """The time limit truncates; it does not terminate."""
    env = CityEnv(CityConfig(time_limit=2.0))
    env.reset(seed=2)
    ends = [env.step(np.array([0.0, -1.0]))[2:4] for _ in range(20)]
    env.close()
    assert ends[-1] == (False, True) and not any(t for pair in ends[:-1] for t in pair)


def test_light_and_traffic_vary_with_the_seed(env: CityEnv) -> None:
    """Mean brightness spans day to dark; obstacles differ from seed to seed."""
    brightness, places = [], set()
    for seed in range(12):
        observation, _ = env.reset(seed=seed)
        brightness.append(observation["image"].mean())
        places.add(tuple(round(o.s, 3) for o in env.scene().obstacles))
    assert max(brightness) > 1.6 * min(brightness)
    assert len(places) == 12


def test_yellow_centre_line_is_seen_in_every_light(env: CityEnv) -> None:
    """From the start of the home lane a few pixels are clearly more yellow than blue."""
    for seed in range(12):
        image = env.reset(seed=seed)[0]["image"].astype(float)
        yellow = np.minimum(image[..., 0], image[..., 1]) - image[..., 2]
        assert (yellow[30:] > 25.0).sum() >= 4, seed


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("difficulty", "trivial"),
        ("route_length", 10.0),
        ("lidar_dropout", 1.5),
        ("time_limit", 0.0),
        ("route_spread", 450.0),
        ("min_brightness", 1.5),
        ("collision_distance", 40.0),
        ("lidar_beams", 90.5),
        ("lidar_beams", 1),
        ("image_size", 8),
        ("reward", 3.0),
        ("track", 3.0),
    ],
)
def test_nonsense_is_refused_by_name(field: str, value: object) -> None:
    """The error names the field and shows the value."""
    with pytest.raises(ValueError, match=f"`{field}`.*{value}"):
        CityConfig(**{field: value})


@pytest.mark.parametrize("kind", [CityConfig, RewardConfig, FaultConfig])
def test_every_number_is_checked(kind: type) -> None:
    """NaN, infinities, negative values and other types are refused by name in every field."""
    numbers = [entry.name for entry in fields(kind) if entry.type in (float, int)]
    assert numbers
    for name in numbers:
        for value in (math.nan, math.inf, -math.inf, -1.0, "1", None):
            with pytest.raises(ValueError, match=f"`{name}` must .*{value!r}"):
                kind(**{name: value})


@pytest.mark.parametrize("key", ["lidar_noise", "initial_speed", "reward.goal", "faults.latency"])
@pytest.mark.parametrize("value", [math.nan, -0.5, math.inf])
def test_the_command_line_names_the_key(key: str, value: float) -> None:
    """What is refused here is refused by the whole configuration, with the dotted key."""
    mapping = to_mapping(RunConfig())
    node = mapping["env"]
    *groups, name = key.split(".")
    for group in groups:
        node = node[group]
    node[name] = value
    with pytest.raises(ConfigError, match=f"env[.]{key}"):
        parse(mapping)


def test_the_axles_are_within_the_car() -> None:
    """A wheelbase beyond the front bumper is refused before anything starts."""
    mapping = to_mapping(RunConfig())
    mapping["limits"]["wheelbase"] = 3.9
    with pytest.raises(ConfigError, match=r"limits\.wheelbase.*3\.9"):
        parse(mapping)


def test_gymnasium_makes_it_from_plain_values() -> None:
    """A mapping, keyword arguments or a `CityConfig`, nested parts included; JSON and back."""
    reward = {"goal": 5.0}
    made = [
        gymnasium.make(CITY_ID, config={"difficulty": "hard", "reward": reward}),
        gymnasium.make(CITY_ID, difficulty="hard", reward=reward),
        gymnasium.make(CITY_ID, config=CityConfig(), difficulty="hard", reward=reward),
        gymnasium.make(
            CITY_ID, config=CityConfig(difficulty="hard", reward=RewardConfig(goal=5.0))
        ),
        gymnasium.make(CITY_ID, difficulty="hard", reward=reward, limits={"dt": 0.05}),
        gymnasium.make(CITY_ID, difficulty="hard", reward=reward, limits=ActuatorLimits(dt=0.05)),
    ]
    for env in made:
        assert env.spec is not None
        again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
        for one in (env.unwrapped, again.unwrapped):
            assert isinstance(one, CityEnv)
            assert one.config == CityConfig(difficulty="hard", reward=RewardConfig(goal=5.0))
        assert again.unwrapped.limits == env.unwrapped.limits
        env.close()
        again.close()
    assert [env.unwrapped.limits.dt for env in made] == [0.1] * 4 + [0.05] * 2
    assert made[-1].metadata["render_fps"] == 20


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"config": 3}, "`config` must be a CityConfig"),
        ({"limits": 3}, "`limits` must be a"),
        ({"config": {"difficult": "hard"}}, "'difficult'"),
        ({"difficult": "hard"}, "'difficult'"),
        ({"reward": {"gaol": 1.0}}, "'gaol'"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], says: str) -> None:
    """A wrong type or an unknown field is one line that names it."""
    with pytest.raises(TypeError, match=says):
        gymnasium.make(CITY_ID, **arguments)


def test_stepping_before_a_reset_says_so(env: CityEnv) -> None:
    """Not an `AttributeError`."""
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset"):
        env.step(STRAIGHT)


def test_unknown_render_mode_is_refused() -> None:
    """Only "rgb_array" exists, and it gives a picture."""
    with pytest.raises(ValueError, match="human"):
        CityEnv(render_mode="human")
    env = CityEnv(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    env.close()
    assert picture is not None and picture.shape == (360, 640, 3) and picture.std() > 10.0
