"""The rollout buffer that mixes the rewards."""

from typing import NamedTuple

import numpy as np
import pytest
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from irl_dal.learning.collection.recorder import EpisodeEnd
from irl_dal.learning.reinforcement.rollout_buffer import HybridRolloutBuffer
from tests.irl_dal.learning.samples import (
    ACTION_SPACE,
    GAMMA,
    OBSERVATION_SPACE,
    hybrid,
    observation,
    record,
)

LAMBDA = 0.8

CHANNELS_FIRST = spaces.Dict(
    {**OBSERVATION_SPACE.spaces, "image": spaces.Box(0, 255, (3, 64, 64), np.uint8)}
)
"""As PPO sees the city."""


class Outcome(NamedTuple):
    """What happened in a step; `bootstrap` is what stable-baselines3 adds at a time limit."""

    env_reward: float
    end: EpisodeEnd = EpisodeEnd.GOES_ON
    bootstrap: float = 0.0


def filled_buffer(
    outcomes: list[list[Outcome]], values: NDArray[np.float32]
) -> HybridRolloutBuffer:
    """A buffer with the outcomes [step][car] and values (T, E); the policy sampled zeros."""
    cars = len(outcomes[0])
    buffer = HybridRolloutBuffer(
        len(outcomes),
        CHANNELS_FIRST,
        ACTION_SPACE,
        n_envs=cars,
        gae_lambda=LAMBDA,
        gamma=GAMMA,
        rng=np.random.default_rng(0),
    )
    starts = np.ones(cars, np.bool_)
    for step, row in enumerate(outcomes):
        seen = observation(np.random.default_rng(step))
        first = seen | {"image": seen["image"].transpose(2, 0, 1)}
        buffer.note([record(seen, o.env_reward, end=o.end, executed=0.1 * step) for o in row])
        buffer.add(
            {key: np.stack([values] * cars) for key, values in first.items()},
            np.zeros((cars, 2), np.float32),
            np.array([o.env_reward + o.bootstrap for o in row]),
            starts,
            torch.from_numpy(values[step]),
            torch.full((cars,), -1.0),
        )
        starts = np.array([o.end is not EpisodeEnd.GOES_ON for o in row])
    return buffer


def column(outcomes: list[Outcome]) -> list[list[Outcome]]:
    """Of one car."""
    return [[outcome] for outcome in outcomes]


def test_advantages_agree_with_an_independent_recomputation() -> None:
    """Mixed rewards, returns and GAE against the sums of their definitions, ends of all kinds."""
    ends = {3: EpisodeEnd.FAILURE, 6: EpisodeEnd.SUCCESS, 8: EpisodeEnd.TIME_LIMIT}
    rng = np.random.default_rng(0)
    env, values = rng.normal(size=12), rng.normal(size=12).astype(np.float32)
    logits = rng.normal(scale=4.0, size=12).astype(np.float32)
    last_value, at_limit = 0.7, 1.3
    outcomes = [
        Outcome(float(env[t]), ends.get(t, EpisodeEnd.GOES_ON), GAMMA * at_limit * (t == 8))
        for t in range(12)
    ]
    buffer = filled_buffer(column(outcomes), values[:, None])
    buffer.finish(hybrid(unit_returns=False), logits, None, torch.tensor([[last_value]]))

    imitation = np.clip(logits / 4.0, -1.0, 1.0)
    after = {3: -1.0, 6: imitation.mean()}
    mixed = np.array(
        [
            0.7 * env[t] + 0.3 * (imitation[t] + after.get(t, 0.0) * GAMMA / (1 - GAMMA))
            for t in range(12)
        ]
    )
    mixed[8] += GAMMA * at_limit
    following = np.append(values[1:], last_value)
    delta = [mixed[t] - values[t] + (0 if t in ends else GAMMA * following[t]) for t in range(12)]
    for t in range(12):
        stop = min([k for k in ends if k >= t] + [11])
        direct = sum((GAMMA * LAMBDA) ** (k - t) * delta[k] for k in range(t, stop + 1))
        assert buffer.advantages[t, 0] == pytest.approx(direct, rel=1e-4, abs=1e-4)
        assert buffer.returns[t, 0] == pytest.approx(direct + values[t], rel=1e-4, abs=1e-4)
    assert buffer.rewards[:, 0] == pytest.approx(mixed, rel=1e-5, abs=1e-5)
    assert buffer.env_rewards[:, 0] == pytest.approx(env, rel=1e-6)
    assert buffer.imitation_rewards[:, 0] == pytest.approx(imitation, rel=1e-6)
    assert buffer.executed_actions[:, 0, 1] == pytest.approx(0.1 * np.arange(12))


def test_before_the_discriminator_is_trained_only_the_environment_counts() -> None:
    """No logits: r_irl is zero everywhere, at ends too."""
    outcomes = column([Outcome(1.0), Outcome(-20.0, EpisodeEnd.FAILURE)])
    buffer = filled_buffer(outcomes, np.zeros((2, 1), np.float32))
    buffer.finish(hybrid(), None, None, torch.zeros(1, 1))
    assert buffer.rewards[:, 0] == pytest.approx(np.array([0.07, -1.4]), rel=1e-5)


def test_unit_returns_keep_the_critic_at_the_size_of_one_reward() -> None:
    """A constant reward of 1 for ever has the return 1."""
    buffer = filled_buffer([[Outcome(1.0)]] * 400, np.ones((400, 1), np.float32))
    buffer.finish(hybrid(w_env=1.0, w_irl=0.0), None, None, torch.ones(1, 1))
    assert buffer.returns == pytest.approx(np.ones((400, 1)), abs=1e-4)


def test_renewed_values_replace_those_seen_on_the_way() -> None:
    """Advantages come from the policy that the update begins with; unlikely actions weigh less."""
    outcomes = column([Outcome(float(t)) for t in range(6)])
    new = np.linspace(-1.0, 1.0, 6, dtype=np.float32)
    log_probs = np.array([-1.0, -2.0, 0.0, -1.0, -4.0, -0.5], np.float32)
    plain = filled_buffer(outcomes, new[:, None])
    plain.finish(hybrid(), None, None, torch.zeros(1, 1))
    renewed = filled_buffer(outcomes, np.zeros((6, 1), np.float32))
    renewed.finish(hybrid(), None, (new, log_probs), torch.zeros(1, 1))
    weights = np.exp(np.minimum(log_probs - -1.0, 0.0))
    assert renewed.advantages[:, 0] == pytest.approx(plain.advantages[:, 0] * weights, abs=1e-6)
    assert renewed.returns == pytest.approx(plain.returns)
    assert np.array_equal(renewed.log_probs[:, 0], log_probs)


def test_minibatches_cover_the_rollout_in_an_order_from_the_given_generator() -> None:
    """Every step comes once; the global generators are not asked."""
    outcomes, orders = column([Outcome(float(t)) for t in range(10)]), []
    for _ in range(2):
        buffer = filled_buffer(outcomes, np.arange(10, dtype=np.float32)[:, None])
        buffer.finish(hybrid(), None, None, torch.zeros(1, 1))
        before = np.random.get_state()[1].copy()
        batches = list(buffer.get(4))
        assert np.array_equal(np.random.get_state()[1], before)
        assert [len(batch.actions) for batch in batches] == [4, 4, 2]
        orders.append(torch.cat([batch.old_values for batch in batches]).tolist())
    assert orders[0] == orders[1]
    assert orders[0] != sorted(orders[0])
    assert sorted(orders[0]) == list(range(10))


def test_each_car_has_its_own_returns_and_its_own_ends() -> None:
    """Two cars in one buffer are two buffers of one car each, the mean of r_irl apart."""
    rng = np.random.default_rng(3)
    ends = {(2, 0): EpisodeEnd.FAILURE, (4, 1): EpisodeEnd.TIME_LIMIT}
    env, logits = rng.normal(size=(6, 2)), rng.normal(scale=3.0, size=(6, 2)).astype(np.float32)
    values = rng.normal(size=(6, 2)).astype(np.float32)

    def buffer_of(cars: list[int]) -> HybridRolloutBuffer:
        outcomes = [
            [Outcome(float(env[t, car]), ends.get((t, car), EpisodeEnd.GOES_ON)) for car in cars]
            for t in range(6)
        ]
        buffer = filled_buffer(outcomes, values[:, cars])
        buffer.finish(hybrid(), logits[:, cars].reshape(-1), None, torch.zeros(len(cars), 1))
        return buffer

    both = buffer_of([0, 1])
    for car in (0, 1):
        alone = buffer_of([car])
        assert both.returns[:, car] == pytest.approx(alone.returns[:, 0], abs=1e-5)
        assert both.advantages[:, car] == pytest.approx(alone.advantages[:, 0], abs=1e-5)
        assert np.array_equal(both.ends[:, car], alone.ends[:, 0])
    batches = list(both.get(4))
    for name, whole in (("returns", both.returns), ("old_values", values)):
        drawn = torch.cat([getattr(batch, name) for batch in batches]).tolist()
        assert sorted(drawn) == pytest.approx(sorted(whole.flatten().tolist()))
    pairs = {
        (round(float(v), 4), round(float(r), 4))
        for batch in batches
        for v, r in zip(batch.old_values, batch.returns, strict=True)
    }
    expected = zip(both.values.flatten(), both.returns.flatten(), strict=True)
    assert pairs == {(round(float(v), 4), round(float(r), 4)) for v, r in expected}
