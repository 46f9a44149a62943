"""The city is the same in every process."""

import multiprocessing

import numpy as np

from irl_dal.envs import CityConfig, CityEnv

SHORT = CityConfig(route_length=120.0, route_spread=0.0)
STEPS = 25


def trace(seed: int) -> list[bytes]:
    """Observations of an episode under actions drawn from the seed, bit by bit."""
    env = CityEnv(SHORT)
    observation, _ = env.reset(seed=seed)
    rng, seen = np.random.default_rng(seed), []
    for _ in range(STEPS):
        seen.append(b"".join(observation[key].tobytes() for key in sorted(observation)))
        action = np.array([rng.uniform(-0.1, 0.1), rng.uniform(0.0, 0.5)])
        observation, _, terminated, truncated, _ = env.step(action)
        assert not (terminated or truncated)
    env.close()
    return seen


def test_another_process_drives_the_same_trajectory() -> None:
    """A fresh interpreter sees the same images, scans and speeds."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        elsewhere = pool.apply(trace, (3,))
    assert trace(3) == elsewhere


def test_two_workers_of_stable_baselines3() -> None:
    """`SubprocVecEnv` resets, steps and restarts two cities that differ by their seeds."""
    from stable_baselines3.common.vec_env import SubprocVecEnv  # which the other test's need not

    envs = SubprocVecEnv([lambda: CityEnv(SHORT)] * 2, start_method="fork")
    try:
        envs.seed(5)
        first = envs.reset()
        assert first["image"].shape == (2, 64, 64, 3)
        assert not np.array_equal(first["image"][0], first["image"][1])
        ended = 0
        for _ in range(60):
            observation, reward, dones, _ = envs.step(np.tile([-0.4, 0.0], (2, 1)))
            ended += int(dones.sum())
            assert np.isfinite(reward).all() and observation["lidar"].shape == (2, 180)
        assert ended >= 2
    finally:
        envs.close()
