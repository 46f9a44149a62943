"""The critic's warm start."""

import numpy as np
import torch

from irl_dal.learning.reinforcement.critic import warm_start_critic
from irl_dal.learning.reinforcement.policy import actor_parameters
from tests.irl_dal.learning.samples import filled_replay, new_policy


def test_the_critic_explains_the_experts_returns_and_nothing_else_moves() -> None:
    """The value head learns; the actor and the shared features stay bit for bit."""
    policy, replay = new_policy(), filled_replay(300)
    before = [p.detach().clone() for p in actor_parameters(policy)]
    arguments = {"gamma": 0.5, "scale": 1.0}
    explained = warm_start_critic(
        policy, replay, steps=200, rng=np.random.default_rng(0), **arguments
    )
    assert explained > 0.5
    assert all(torch.equal(p, q) for p, q in zip(actor_parameters(policy), before, strict=True))


def test_without_steps_there_is_no_warm_start() -> None:
    """Zero steps leave the critic as it is and say so with a NaN."""
    policy = new_policy()
    before = policy.value_net.weight.clone()
    explained = warm_start_critic(
        policy, filled_replay(20), gamma=0.9, scale=1.0, steps=0, rng=np.random.default_rng(0)
    )
    assert np.isnan(explained)
    assert torch.equal(policy.value_net.weight, before)
