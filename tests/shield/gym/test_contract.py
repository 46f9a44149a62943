"""What gymnasium asks of a wrapper: specifications, copies, equal infos."""

import copy
import json
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from shield import ActuatorLimits, SafetyFilter
from shield.gym import ShieldedEnv
from tests.shield.gym.recorder import DT, RATE, Recorder, unit_box
from tests.shield.strategies import CITY


def test_the_wrapper_can_be_rebuilt_from_its_spec() -> None:
    """As gymnasium asks of wrappers."""
    env = ShieldedEnv(gymnasium.make("Pendulum-v1"), rate=RATE, dt=DT)
    assert env.spec is not None
    again = gymnasium.make(env.spec)
    again.reset(seed=0)
    certificate = again.step(np.array([2.0], np.float32))[-1]["certificate"]
    assert certificate.safe_action[0] == pytest.approx(RATE * DT)


@pytest.mark.parametrize("arguments", [{"rate": 0.5}, {"limits": CITY, "normalised": True}])
def test_gymnasium_finds_nothing_wrong(arguments: dict[str, Any]) -> None:
    """`check_env` compares the infos of two equal episodes, certificates included."""
    env = ShieldedEnv(Recorder(unit_box()), **arguments)
    check_env(env, skip_render_check=True)


def test_certificates_compare_by_what_they_say() -> None:
    """Equal where the actions are; the time of the call is no part of that; NaN is itself."""
    wishes = [[0.4, 9.0], [np.nan, 1.0]]
    first, second = ([SafetyFilter(CITY).filter(wish) for wish in wishes] for _ in range(2))
    assert first == second
    assert hash(first[1]) == hash(second[1])
    assert first[0] != first[1]
    assert first[0] != SafetyFilter(CITY).filter([0.4, 8.0])
    assert first[0] != "certificate"


@pytest.mark.parametrize("arguments", [{"rate": 0.1}, {"limits": CITY, "normalised": True}])
def test_a_deep_copy_goes_on_by_itself(arguments: dict[str, Any]) -> None:
    """From the same last executed action, and without a trace in the original."""
    env, other = (ShieldedEnv(Recorder(unit_box()), **arguments) for _ in range(2))
    for one in (env, other):
        one.reset(seed=0)
        one.step(np.array([0.05, 0.05], np.float32))
    ahead = copy.deepcopy(env)
    wish = np.ones(2, np.float32)
    expected = ahead.step(wish)[-1]["certificate"]
    for _ in range(3):
        ahead.step(wish)
    assert env.step(wish)[-1]["certificate"] == expected
    assert other.step(wish)[-1]["certificate"] == expected


@pytest.mark.parametrize(
    "arguments", [{"rate": [7.3], "low": np.array([-1.0]), "dt": DT}, {"rest": [0.5]}]
)
def test_a_specification_survives_json(arguments: dict[str, Any]) -> None:
    """Arrays are lists in it, limits the mapping of their fields."""
    env = ShieldedEnv(gymnasium.make("Pendulum-v1"), **arguments)
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    env.reset(seed=0)
    again.reset(seed=0)
    wish = np.array([-2.0], np.float32)
    for _ in range(5):
        assert again.step(wish)[-1]["certificate"] == env.step(wish)[-1]["certificate"]


def test_limits_survive_json() -> None:
    """And the wrapper takes them as a mapping."""
    limits = ActuatorLimits(max_speed=7.0, max_lateral_acceleration=None)
    env = ShieldedEnv(Recorder(unit_box()), limits, normalised=True)
    arguments = json.loads(json.dumps(env._saved_kwargs))
    again = ShieldedEnv(Recorder(unit_box()), **arguments)
    for one in (env, again):
        one.reset(seed=0)
    wish = np.array([0.3, 0.9], np.float32)
    assert again.step(wish)[-1]["certificate"] == env.step(wish)[-1]["certificate"]
