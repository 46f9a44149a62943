"""A copy of the city is a city of its own that goes on as the original would."""

import copy
import pickle
from collections.abc import Callable

import gymnasium
import numpy as np
import pytest

from irl_dal.envs import CITY_ID, FAULTS, CityConfig, CityEnv

HARD = CityConfig(difficulty="hard")
KINDS = {
    "default": CityConfig(),
    "hard": HARD,
    "odometry": CityConfig(lane_sensor="odometry"),
    "latency": CityConfig(faults=FAULTS["latency_2"]),
}
WAYS: dict[str, Callable[[CityEnv], CityEnv]] = {
    "deepcopy": copy.deepcopy,
    "copy": copy.copy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}


def ahead(env: CityEnv, steps: int = 12, seed: int = 0) -> list[bytes]:
    """All that `steps` steps show, bit by bit."""
    rng, seen = np.random.default_rng(seed), []
    for _ in range(steps):
        observation, reward, *_, info = env.step(rng.uniform((-0.1, 0.3), (0.1, 0.6)))
        seen += [observation[key].tobytes() for key in sorted(observation)]
        seen += [np.float64(reward).tobytes(), info["pose"].tobytes()]
        seen += [np.float64([(o.s, o.d) for o in env.scene().obstacles]).tobytes()]
    return seen


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS.keys())
@pytest.mark.parametrize("kind", KINDS)
def test_a_copy_goes_on_as_the_original(kind: str, way: Callable[[CityEnv], CityEnv]) -> None:
    """Images, scans, rewards and traffic are the same, whichever of the two is driven first."""
    env = CityEnv(KINDS[kind])
    env.reset(seed=4)
    ahead(env, 8, seed=1)
    twin = way(env)
    first = ahead(twin)
    assert ahead(env) == first
    # The next episode without a seed as well.
    assert env.reset()[1]["pose"].tolist() == twin.reset()[1]["pose"].tolist()
    assert ahead(env, 3) == ahead(twin, 3)
    twin.close()
    env.step(np.zeros(2))
    env.close()


def test_a_camera_that_was_off_is_off_in_the_copy() -> None:
    """The camera's noise has a stream of its own, which only its images advance."""
    env = CityEnv(KINDS["odometry"])
    env.reset(seed=4)
    env.camera_on = False
    ahead(env, 4)
    env.camera_on = True
    ahead(env, 3)
    twin = copy.deepcopy(env)
    assert ahead(twin) == ahead(env)
    twin.close()
    env.close()


def test_a_copy_keeps_spaces_and_specification() -> None:
    """A wrapped city is copied with its wrappers; sampling goes on where it was."""
    env = gymnasium.make(CITY_ID, config=HARD)
    env.reset(seed=1)
    env.action_space.seed(7)
    env.action_space.sample()
    twin = copy.deepcopy(env)
    assert twin.spec == env.spec and twin.unwrapped is not env.unwrapped
    assert np.array_equal(twin.action_space.sample(), env.action_space.sample())
    twin.close()
    env.close()


def test_a_city_before_its_first_reset_is_copied() -> None:
    """There is nothing to drive again."""
    env = CityEnv(HARD)
    twin = copy.deepcopy(env)
    poses = [one.reset(seed=3)[1]["pose"].tolist() for one in (env, twin)]
    assert poses[0] == poses[1] and twin.config == HARD
    twin.close()
    env.close()


def test_what_cannot_be_copied_says_so() -> None:
    """A closed city, or the physics by itself: one clear TypeError."""
    env = CityEnv()
    env.reset(seed=3)
    with pytest.raises(TypeError, match="physics world"):
        copy.deepcopy(env._traffic)
    env.close()
    with pytest.raises(TypeError, match="closed"):
        copy.deepcopy(env)
