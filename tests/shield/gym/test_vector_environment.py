"""The shield around vectorised environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from shield.gym import ShieldedEnv, ShieldedVectorEnv
from tests.shield.gym.recorder import DT, RATE, assert_rates, vector_of_recorders


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectorised_environments_are_shielded_one_by_one(mode: str) -> None:
    """`ShieldedEnv` of a vectorised environment gives certificates for each."""
    env = ShieldedEnv(
        gymnasium.make_vec("Pendulum-v1", num_envs=3, vectorization_mode=mode), rate=RATE, dt=DT
    )
    assert isinstance(env, ShieldedVectorEnv)
    env.reset(seed=0)
    env.action_space.seed(0)
    executed: list[list[np.ndarray]] = [[], [], []]
    for _ in range(50):
        info = env.step(env.action_space.sample())[-1]
        assert info["_certificate"].all()
        for index in range(3):
            executed[index].append(info["certificate"][index].safe_action)
    for actions in executed:
        assert_rates(actions, -2.0, 2.0, RATE * DT)
    env.close()


def test_a_sub_environment_that_ends_starts_from_rest_again() -> None:
    """In each autoreset mode the first action of an episode is tied to rest, not to the old one."""
    wish = np.ones((2, 1), np.float32)
    env, recorders = vector_of_recorders(AutoresetMode.NEXT_STEP)
    env.reset()
    infos = [env.step(wish)[-1] for _ in range(5)]
    assert infos[3]["_certificate"].tolist() == [False, True]
    assert infos[3]["certificate"][0] is None
    assert infos[4]["certificate"][0].safe_action.tolist() == [0.25]
    assert infos[4]["certificate"][1].safe_action.tolist() == [1.0]
    env, recorders = vector_of_recorders(AutoresetMode.SAME_STEP)
    env.reset()
    infos = [env.step(wish)[-1] for _ in range(4)]
    assert infos[3]["certificate"][0].safe_action.tolist() == [0.25]
    assert infos[3]["certificate"][1].safe_action.tolist() == [1.0]
    env, recorders = vector_of_recorders(AutoresetMode.DISABLED)
    env.reset()
    for _ in range(3):
        env.step(wish)
    env.reset(options={"reset_mask": np.array([True, False])})
    info = env.step(wish)[-1]
    assert info["certificate"][0].safe_action.tolist() == [0.25]
    assert info["certificate"][1].safe_action.tolist() == [1.0]
    assert len(recorders) == 2
