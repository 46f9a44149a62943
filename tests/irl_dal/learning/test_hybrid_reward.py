"""The hybrid reward and the rollout buffer that mixes it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from irl_dal.learning.hybrid_reward import (
    Appraise,
    End,
    HybridReward,
    HybridRewardConfig,
    HybridRolloutBuffer,
    StepOutcome,
)
from tests.irl_dal.learning.samples import ACTION_SPACE, OBSERVATION_SPACE, observation

GAMMA, LAMBDA = 0.9, 0.8


def hybrid(logits: NDArray[np.float32] | None = None, **arguments: object) -> HybridReward:
    """A hybrid reward whose discriminator always says `logits`."""
    return HybridReward(HybridRewardConfig(**arguments), GAMMA, lambda _seen, _acts: logits)


def filled_buffer(
    reward: HybridReward,
    outcomes: list[StepOutcome],
    values: NDArray[np.float32],
    bootstraps: dict[int, float] | None = None,
    appraise: Appraise | None = None,
) -> HybridRolloutBuffer:
    """A buffer with one step per outcome, as stable-baselines3's loop fills it."""
    buffer = HybridRolloutBuffer(
        len(outcomes),
        OBSERVATION_SPACE,
        ACTION_SPACE,
        gae_lambda=LAMBDA,
        gamma=GAMMA,
        hybrid=reward,
        rng=np.random.default_rng(0),
        appraise=appraise,
    )
    rng, starts = np.random.default_rng(1), True
    for step, outcome in enumerate(outcomes):
        seen = {key: value[None] for key, value in observation(rng).items()}
        given_reward = outcome.env_reward + (bootstraps or {}).get(step, 0.0)
        buffer.annotate([outcome])
        buffer.add(
            seen,
            np.zeros((1, 2), np.float32),
            np.array([given_reward], np.float32),
            np.array([starts]),
            torch.tensor([[values[step]]]),
            torch.tensor([-1.0]),
        )
        starts = outcome.end is not End.GOES_ON
    return buffer


def outcome(env_reward: float, end: End = End.GOES_ON, executed: float = 0.0) -> StepOutcome:
    """What happened in a step."""
    return StepOutcome(env_reward, np.full(2, executed, np.float32), end)


def test_advantages_agree_with_an_independent_recomputation() -> None:
    """Mixed rewards, returns and GAE against the sums of their definitions, ends of all kinds."""
    ends = {3: End.FAILURE, 6: End.SUCCESS, 8: End.TIME_LIMIT}
    rng = np.random.default_rng(0)
    env, values = rng.normal(size=12), rng.normal(size=12).astype(np.float32)
    logits = rng.normal(scale=4.0, size=12).astype(np.float32)
    last_value, at_limit = 0.7, 1.3
    reward = hybrid(logits, unit_returns=False)
    outcomes = [outcome(float(env[t]), ends.get(t, End.GOES_ON)) for t in range(12)]
    buffer = filled_buffer(reward, outcomes, values, {8: GAMMA * at_limit})
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


@given(st.floats(-200.0, 200.0))
def test_both_forms_are_bounded_and_grow_with_the_logit(logit: float) -> None:
    """Centred is in [-1, 1] and odd; printed in [r_min, r_max]; neither falls as D grows."""
    centred, printed = hybrid(), hybrid(form="printed", r_max=3.0)
    near = np.array([logit, logit + 1.0, -logit], np.float32)
    r = centred.imitation_reward(near)
    assert np.all(np.abs(r) <= 1.0)
    assert r[0] <= r[1]
    assert r[0] == pytest.approx(-r[2], abs=1e-6)
    p = printed.imitation_reward(near)
    assert np.all((p >= 0.0) & (p <= 3.0))
    assert p[0] <= p[1] + 1e-6


def test_the_printed_form_is_the_papers_equation() -> None:
    """-log(1 - D + eps) with D the sigmoid of the logit, before the clipping matters."""
    logits = np.array([-2.0, 0.0, 1.5], np.float32)
    printed = hybrid(form="printed", epsilon=1e-8).imitation_reward(logits)
    d = 1.0 / (1.0 + np.exp(-logits))
    assert printed == pytest.approx(-np.log(1.0 - d + 1e-8), rel=1e-5)


def test_the_printed_form_pays_for_every_step_and_the_centred_one_does_not() -> None:
    """An agent that is found out earns from going on as printed, loses as centred."""
    logits = np.full(5, -1.0, np.float32)
    assert np.all(hybrid(form="printed").imitation_reward(logits) > 0.0)
    assert np.all(hybrid().imitation_reward(logits) < 0.0)


@given(st.lists(st.floats(-30.0, 30.0, width=32), min_size=2, max_size=20))
def test_failing_is_never_better_than_driving_on(logits: list[float]) -> None:
    """Whatever D says, r_irl after a failure is at most that of any way of going on."""
    reward = hybrid(np.array(logits, np.float32))
    imitation = reward.imitation_reward(np.array(logits, np.float32))
    ends = np.full(len(logits), End.GOES_ON, np.int8)
    ends[-1] = End.FAILURE
    after = reward.continuation(ends, imitation)
    any_other_way = sum(GAMMA**k * imitation.min() for k in range(1, 2000))
    assert after[-1] <= any_other_way + 1e-3
    assert np.all(after[:-1] == 0.0)


def test_without_absorbing_states_an_end_is_worth_nothing() -> None:
    """The printed behaviour stays selectable; then a crash ends a negative reward."""
    reward = hybrid(absorbing=False)
    imitation = np.full(3, -1.0, np.float32)
    ends = np.array([End.GOES_ON, End.GOES_ON, End.FAILURE], np.int8)
    assert np.all(reward.continuation(ends, imitation) == 0.0)
    assert hybrid().continuation(ends, imitation)[2] == pytest.approx(-GAMMA / (1 - GAMMA))


def test_before_the_discriminator_is_trained_only_the_environment_counts() -> None:
    """No logits: r_irl is zero everywhere, at ends too."""
    outcomes = [outcome(1.0), outcome(-20.0, End.FAILURE)]
    buffer = filled_buffer(hybrid(None), outcomes, np.zeros(2, np.float32))
    buffer.compute_returns_and_advantage(torch.zeros(1, 1), np.array([True]))
    assert buffer.rewards[:, 0] == pytest.approx(np.array([0.07, -1.4]), rel=1e-5)


def test_unit_returns_keep_the_critic_at_the_size_of_one_reward() -> None:
    """A constant reward of 1 for ever has the return 1."""
    outcomes = [outcome(1.0) for _ in range(400)]
    reward = hybrid(None, w_env=1.0, w_irl=0.0)
    buffer = filled_buffer(reward, outcomes, np.ones(400, np.float32))
    buffer.compute_returns_and_advantage(torch.ones(1, 1), np.array([False]))
    assert buffer.returns == pytest.approx(np.ones((400, 1)), abs=1e-4)


def test_corrections_can_be_penalised() -> None:
    """The penalty is the squared distance between the policy's draw and what was executed."""
    outcomes = [outcome(0.0), outcome(0.0, executed=0.5)]
    reward = hybrid(None, correction_penalty=2.0, unit_returns=False)
    buffer = filled_buffer(reward, outcomes, np.zeros(2, np.float32))
    buffer.compute_returns_and_advantage(torch.zeros(1, 1), np.array([False]))
    assert buffer.rewards[:, 0] == pytest.approx(np.array([0.0, -2.0 * 0.5]))


def test_renewed_values_replace_those_seen_on_the_way() -> None:
    """Advantages come from the policy that the update begins with; unlikely actions weigh less."""
    outcomes = [outcome(float(t)) for t in range(6)]
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
    replaced = StepOutcome(
        0.0,
        np.zeros(2, np.float32),
        End.GOES_ON,
        stored_action=(np.array([0.3, -0.2], np.float32), -7.5),
    )
    buffer = filled_buffer(hybrid(None), [outcome(0.0), replaced], np.zeros(2, np.float32))
    assert buffer.actions[:, 0] == pytest.approx(np.array([[0.0, 0.0], [0.3, -0.2]]))
    assert buffer.log_probs[:, 0] == pytest.approx(np.array([-1.0, -7.5]))


def test_minibatches_cover_the_rollout_in_an_order_from_the_given_generator() -> None:
    """Every step comes once; the global generators are not asked."""
    outcomes = [outcome(float(t)) for t in range(10)]
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
    executed = rng.uniform(-1.0, 1.0, (6, 2)).astype(np.float32)
    steps = [
        [outcome(env[t, car], ends.get((t, car), End.GOES_ON), executed[t, car]) for car in (0, 1)]
        for t in range(6)
    ]

    def buffer_of(cars: list[int]) -> HybridRolloutBuffer:
        buffer = HybridRolloutBuffer(
            6,
            OBSERVATION_SPACE,
            ACTION_SPACE,
            n_envs=len(cars),
            gae_lambda=LAMBDA,
            gamma=GAMMA,
            hybrid=hybrid(logits[:, cars].reshape(-1), correction_penalty=0.5),
            rng=np.random.default_rng(0),
        )
        starts = np.ones(len(cars), np.bool_)
        for t in range(6):
            seen = observation(np.random.default_rng(t))
            buffer.annotate([steps[t][car] for car in cars])
            buffer.add(
                {key: np.stack([value] * len(cars)) for key, value in seen.items()},
                np.zeros((len(cars), 2), np.float32),
                env[t, cars].astype(np.float32),
                starts,
                torch.from_numpy(values[t, cars]),
                torch.full((len(cars),), -1.0),
            )
            starts = np.array([steps[t][car].end is not End.GOES_ON for car in cars])
        buffer.compute_returns_and_advantage(torch.zeros(len(cars), 1), starts)
        return buffer

    both = buffer_of([0, 1])
    for car in (0, 1):
        alone = buffer_of([car])
        assert both.returns[:, car] == pytest.approx(alone.returns[:, 0], abs=1e-5)
        assert both.advantages[:, car] == pytest.approx(alone.advantages[:, 0], abs=1e-5)
        assert np.array_equal(both.ends[:, car], alone.ends[:, 0])
    drawn = torch.cat([batch.returns for batch in both.get(4)])
    assert sorted(drawn.tolist()) == pytest.approx(sorted(both.returns.flatten().tolist()))


def test_a_step_without_its_outcome_is_refused() -> None:
    """The buffer cannot guess what was executed."""
    buffer = filled_buffer(hybrid(None), [outcome(0.0)], np.zeros(1, np.float32))
    buffer.reset()
    with pytest.raises(RuntimeError, match="`annotate` must be called"):
        buffer.add({}, np.zeros((1, 2)), np.zeros(1), np.zeros(1), torch.zeros(1), torch.zeros(1))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"w_env": 0.5, "w_irl": 0.3}, "`w_env` and `w_irl` .* add to 1. Got 0.5, 0.3"),
        ({"form": "other"}, "`form` must be one of .*Got 'other'"),
        ({"r_min": 2.0, "r_max": 1.0}, "`r_min` must be below `r_max`. Got 2.0 and 1.0"),
        ({"logit_scale": 0.0}, "`logit_scale` must be positive. Got 0.0"),
        ({"correction_penalty": -1.0}, "`correction_penalty` must not be negative. Got -1.0"),
    ],
)
def test_impossible_values_are_refused(arguments: dict[str, object], message: str) -> None:
    """The refusal names the key and the value."""
    with pytest.raises(ValueError, match=message):
        HybridRewardConfig(**arguments)
