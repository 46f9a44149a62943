"""The rollout buffer that mixes the rewards."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from irl_dal.learning.collection.step_record import Draw, DrivenStep, End
from irl_dal.learning.reinforcement.hybrid_reward import HybridReward
from irl_dal.learning.reinforcement.rollout_buffer import Appraise, Correction, HybridRolloutBuffer
from tests.irl_dal.learning.samples import (
    ACTION_SPACE,
    GAMMA,
    OBSERVATION_SPACE,
    driven,
    hybrid,
    observation,
)

LAMBDA = 0.8

CHANNELS_FIRST = spaces.Dict(
    {**OBSERVATION_SPACE.spaces, "image": spaces.Box(0, 255, (3, 64, 64), np.uint8)}
)
"""As PPO sees the city."""


class Outcome(NamedTuple):
    """What happened in a step."""

    env_reward: float
    end: End = End.GOES_ON
    executed: float = 0.0


def step_of(
    outcome: Outcome, value: float, *, number: int, last_value: float = 0.0, first: bool = False
) -> DrivenStep:
    """The policy drew zeros."""
    draw = Draw(np.zeros(2, np.float32), value, -1.0, last_value)
    seen = observation(np.random.default_rng(number))
    reward, end, executed = outcome
    return driven(seen, draw, reward, end=end, executed=executed, step=0 if first else 1)


def new_buffer(
    reward: HybridReward, steps: int, cars: int = 1, appraise: Appraise | None = None
) -> HybridRolloutBuffer:
    """Without a step yet."""
    return HybridRolloutBuffer(
        steps,
        CHANNELS_FIRST,
        ACTION_SPACE,
        n_envs=cars,
        gae_lambda=LAMBDA,
        gamma=GAMMA,
        hybrid=reward,
        rng=np.random.default_rng(0),
        appraise=appraise,
    )


def filled_buffer(
    reward: HybridReward,
    outcomes: list[Outcome],
    values: NDArray[np.float32],
    last_values: dict[int, float] | None = None,
    appraise: Appraise | None = None,
    corrections: dict[int, Correction] | None = None,
) -> HybridRolloutBuffer:
    """A buffer with one step of one car per outcome."""
    buffer, first = new_buffer(reward, len(outcomes), appraise=appraise), True
    for number, outcome in enumerate(outcomes):
        last_value = (last_values or {}).get(number, 0.0)
        step = step_of(
            outcome, float(values[number]), number=number, last_value=last_value, first=first
        )
        buffer.store([step], [(corrections or {}).get(number)])
        first = outcome.end is not End.GOES_ON
    return buffer


def test_advantages_agree_with_an_independent_recomputation() -> None:
    """Mixed rewards, returns and GAE against the sums of their definitions, ends of all kinds."""
    ends = {3: End.FAILURE, 6: End.SUCCESS, 8: End.TIME_LIMIT}
    rng = np.random.default_rng(0)
    env, values = rng.normal(size=12), rng.normal(size=12).astype(np.float32)
    logits = rng.normal(scale=4.0, size=12).astype(np.float32)
    last_value, at_limit = 0.7, 1.3
    reward = hybrid(logits, unit_returns=False)
    outcomes = [Outcome(float(env[t]), ends.get(t, End.GOES_ON)) for t in range(12)]
    buffer = filled_buffer(reward, outcomes, values, {8: at_limit})
    buffer.compute_returns_and_advantage(torch.tensor([[last_value]]), np.array([False]))

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


def test_before_the_discriminator_is_trained_only_the_environment_counts() -> None:
    """No logits: r_irl is zero everywhere, at ends too."""
    outcomes = [Outcome(1.0), Outcome(-20.0, End.FAILURE)]
    buffer = filled_buffer(hybrid(None), outcomes, np.zeros(2, np.float32))
    buffer.compute_returns_and_advantage(torch.zeros(1, 1), np.array([True]))
    assert buffer.rewards[:, 0] == pytest.approx(np.array([0.07, -1.4]), rel=1e-5)


def test_unit_returns_keep_the_critic_at_the_size_of_one_reward() -> None:
    """A constant reward of 1 for ever has the return 1."""
    outcomes = [Outcome(1.0) for _ in range(400)]
    reward = hybrid(None, w_env=1.0, w_irl=0.0)
    buffer = filled_buffer(reward, outcomes, np.ones(400, np.float32))
    buffer.compute_returns_and_advantage(torch.ones(1, 1), np.array([False]))
    assert buffer.returns == pytest.approx(np.ones((400, 1)), abs=1e-4)


def test_corrections_can_be_penalised() -> None:
    """The penalty is the squared distance between the policy's draw and what was executed."""
    outcomes = [Outcome(0.0), Outcome(0.0, executed=0.5)]
    reward = hybrid(None, correction_penalty=2.0, unit_returns=False)
    buffer = filled_buffer(reward, outcomes, np.zeros(2, np.float32))
    buffer.compute_returns_and_advantage(torch.zeros(1, 1), np.array([False]))
    assert buffer.rewards[:, 0] == pytest.approx(np.array([0.0, -2.0 * 0.5]))


def test_renewed_values_replace_those_seen_on_the_way() -> None:
    """Advantages come from the policy that the update begins with; unlikely actions weigh less."""
    outcomes = [Outcome(float(t)) for t in range(6)]
    old, new = np.zeros(6, np.float32), np.linspace(-1.0, 1.0, 6, dtype=np.float32)
    log_probs = np.array([-1.0, -2.0, 0.0, -1.0, -4.0, -0.5], np.float32)
    plain = filled_buffer(hybrid(None), outcomes, new)
    renewed = filled_buffer(hybrid(None), outcomes, old, appraise=lambda _s, _a: (new, log_probs))
    for buffer in (plain, renewed):
        buffer.compute_returns_and_advantage(torch.zeros(1, 1), np.array([False]))
    weights = np.exp(np.minimum(log_probs - -1.0, 0.0))
    assert renewed.advantages[:, 0] == pytest.approx(plain.advantages[:, 0] * weights, abs=1e-6)
    assert renewed.returns == pytest.approx(plain.returns)
    assert np.array_equal(renewed.log_probs[:, 0], log_probs)


def test_the_policys_own_draw_is_kept_unless_something_else_is_to_be_stored() -> None:
    """Eq. 28's form replaces action and log-probability of that step and of no other."""
    other = (np.array([0.3, -0.2], np.float32), -7.5)
    reward = hybrid(None, correction_penalty=1.0, unit_returns=False)
    outcomes = [Outcome(0.0), Outcome(0.0, executed=0.5)]
    buffer = filled_buffer(reward, outcomes, np.zeros(2, np.float32), corrections={1: other})
    assert buffer.actions[:, 0] == pytest.approx(np.array([[0.0, 0.0], [0.3, -0.2]]))
    assert buffer.log_probs[:, 0] == pytest.approx(np.array([-1.0, -7.5]))
    buffer.compute_returns_and_advantage(torch.zeros(1, 1), np.array([False]))
    assert buffer.rewards[:, 0] == pytest.approx(np.array([0.0, -0.5]))  # of the policy's draw


def test_minibatches_cover_the_rollout_in_an_order_from_the_given_generator() -> None:
    """Every step comes once; the global generators are not asked."""
    outcomes = [Outcome(float(t)) for t in range(10)]
    orders = []
    for _ in range(2):
        buffer = filled_buffer(hybrid(None), outcomes, np.arange(10, dtype=np.float32))
        buffer.compute_returns_and_advantage(torch.zeros(1, 1), np.array([False]))
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
    ends = {(2, 0): End.FAILURE, (4, 1): End.TIME_LIMIT}
    env, logits = rng.normal(size=(6, 2)), rng.normal(scale=3.0, size=(6, 2)).astype(np.float32)
    values = rng.normal(size=(6, 2)).astype(np.float32)
    executed = rng.uniform(-1.0, 1.0, (6, 2))

    def outcome(t: int, car: int) -> Outcome:
        end = ends.get((t, car), End.GOES_ON)
        return Outcome(float(env[t, car]), end, float(executed[t, car]))

    def buffer_of(cars: list[int]) -> HybridRolloutBuffer:
        reward = hybrid(logits[:, cars].reshape(-1), correction_penalty=0.5)
        buffer, over = new_buffer(reward, 6, len(cars)), np.ones(len(cars), np.bool_)
        for t in range(6):
            driven = [
                step_of(outcome(t, car), float(values[t, car]), number=t, first=bool(first))
                for car, first in zip(cars, over, strict=True)
            ]
            buffer.store(driven, [None] * len(cars))
            over = np.array([outcome(t, car).end is not End.GOES_ON for car in cars])
        buffer.compute_returns_and_advantage(torch.zeros(len(cars), 1), over)
        return buffer

    both = buffer_of([0, 1])
    for car in (0, 1):
        alone = buffer_of([car])
        assert both.returns[:, car] == pytest.approx(alone.returns[:, 0], abs=1e-5)
        assert both.advantages[:, car] == pytest.approx(alone.advantages[:, 0], abs=1e-5)
        assert np.array_equal(both.ends[:, car], alone.ends[:, 0])
    drawn = torch.cat([batch.returns for batch in both.get(4)])
    assert sorted(drawn.tolist()) == pytest.approx(sorted(both.returns.flatten().tolist()))


def test_steps_that_the_policy_did_not_drive_are_refused() -> None:
    """There is nothing to reinforce in them; nor may a car be missing."""
    step = step_of(Outcome(0.0), 0.0, number=0)
    buffer = new_buffer(hybrid(None), 1)
    with pytest.raises(ValueError, match="`driven` must have 1 draws. Got 0."):
        buffer.store([replace(step, draw=None)], [None])
    with pytest.raises(ValueError, match="`driven` must have 2 draws. Got 1."):
        new_buffer(hybrid(None), 1, cars=2).store([step], [None])
