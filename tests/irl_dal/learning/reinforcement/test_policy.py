"""The policy around stable-baselines3's actor and critic."""

import numpy as np
import pytest
import torch

from irl_dal.learning.reinforcement.policy import (
    PERCEIVED,
    actor_parameters,
    appraise,
    mean_action,
    observation_tensors,
)
from tests.irl_dal.learning.samples import filled_replay, new_policy, observation


def some_observations(count: int = 8) -> dict[str, torch.Tensor]:
    """A batch as the policy takes it."""
    return observation_tensors(filled_replay(20).sample(np.random.default_rng(0), count))


def test_exploration_comes_from_the_policys_own_generator() -> None:
    """Same generator state, same draws; torch's global generator is not asked."""
    policy, seen = new_policy(), some_observations()
    policy.generator = torch.Generator().manual_seed(3)
    before = torch.get_rng_state()
    first = policy(seen)[0]
    policy.generator.manual_seed(3)
    assert torch.equal(policy(seen)[0], first)
    assert not torch.equal(policy(seen)[0], first)
    assert torch.equal(torch.get_rng_state(), before)


def test_drawn_actions_follow_the_policys_own_distribution() -> None:
    """Mean and spread of many draws are those of the Gaussian whose log-probability is returned."""
    policy, seen = new_policy(), some_observations(1)
    policy.generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        policy.log_std.copy_(torch.tensor([-2.0, -1.0]))
        many = {key: value.expand(1500, *value.shape[1:]) for key, value in seen.items()}
        actions, values, log_prob = policy(many)
        mean = mean_action(policy, seen)[0]
        expected = policy.evaluate_actions(many, actions)
    assert actions.std(dim=0).numpy() == pytest.approx(np.exp([-2.0, -1.0]), rel=0.1)
    assert (actions.mean(dim=0) - mean).abs().max().item() < 0.03
    assert torch.allclose(log_prob, expected[1], atol=1e-5)
    assert torch.allclose(values, expected[0], atol=1e-5)


def test_deterministic_actions_are_the_mean() -> None:
    """What an evaluation executes is what behaviour cloning trains."""
    policy, seen = new_policy(), some_observations()
    with torch.no_grad():
        assert torch.equal(policy(seen, deterministic=True)[0], mean_action(policy, seen))


def test_the_citys_own_observation_and_a_replay_batch_mean_the_same() -> None:
    """`predict` on a channels-last camera image agrees with the tensors made from the buffer."""
    policy = new_policy()
    rng = np.random.default_rng(0)
    seen = observation(rng)
    action, _ = policy.predict(seen, deterministic=True)
    tensors = {
        "image": torch.from_numpy(seen["image"]).permute(2, 0, 1)[None],
        "lidar": torch.from_numpy(seen["lidar"])[None],
        "speed": torch.from_numpy(seen["speed"])[None],
        "context": torch.from_numpy(seen["context"])[None],
    }
    with torch.no_grad():
        mean = mean_action(policy, tensors)[0].clamp(-1.0, 1.0).numpy()
    assert action == pytest.approx(mean, abs=1e-6)


def test_actor_parameters_are_those_that_move_the_mean_action() -> None:
    """A gradient of the mean action reaches all of them and nothing else."""
    policy = new_policy()
    mean_action(policy, some_observations()).square().sum().backward()
    reached = {id(p) for p in policy.parameters() if p.grad is not None}
    assert reached == {id(p) for p in actor_parameters(policy)}


def test_a_rollout_is_appraised_as_the_policy_would_do_it_step_by_step() -> None:
    """Values and log-probabilities in batches equal those of single forward passes."""
    policy, seen = new_policy(), some_observations(7)
    policy.generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        actions, values, log_probs = policy(seen)
    arrays = {key: value.numpy() for key, value in seen.items()}
    found = appraise(policy, arrays, actions.numpy())
    assert found[0] == pytest.approx(values.flatten().numpy(), abs=1e-5)
    assert found[1] == pytest.approx(log_probs.numpy(), abs=1e-4)


def test_perceiving_in_batches_keeps_number_and_order() -> None:
    """Batches of 3 give the features that one batch of 7 gives."""
    policy, seen = new_policy(), some_observations(7)
    arrays = {key: value.numpy() for key, value in seen.items()}
    whole, parts = (policy.perceive(arrays, size)[PERCEIVED] for size in (7, 3))
    assert whole.shape == (7, policy.features_dim)
    assert parts == pytest.approx(whole, abs=1e-5)
