"""Behaviour cloning of the policy's mean action."""

import copy

import numpy as np
import pytest
import torch

from expert.modes import Mode
from irl_dal import shortcuts
from irl_dal.learning.imitation import behaviour_cloning
from irl_dal.learning.imitation.behaviour_cloning import BehaviourCloning, CloningConfig
from irl_dal.learning.reinforcement.policy import actor_parameters, mean_action, observation_tensors
from tests.irl_dal.learning.samples import filled_replay, new_policy


def test_cloning_learns_and_reports_each_mode() -> None:
    """Forty gradient steps halve the held-out loss; every mode of the data is reported."""
    replay, rng = filled_replay(), np.random.default_rng(0)
    cloning = BehaviourCloning(new_policy(), CloningConfig(learning_rate=1e-3))
    before = cloning.validate(replay, np.random.default_rng(1))
    cloning.update(lambda: replay.sample(rng, 32), 40)
    after = cloning.validate(replay, np.random.default_rng(1))
    assert sum(after.values()) < 0.5 * sum(before.values())
    assert sorted(after) == list(Mode)


def test_the_loss_is_the_papers_equation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Batch mean of the squared norm plus lambda times the squared weights, recomputed."""
    monkeypatch.setattr(shortcuts, "NATIVE_BFLOAT16", ())
    replay, policy = filled_replay(50), new_policy()
    l2 = 1e-3
    cloning = BehaviourCloning(policy, CloningConfig(l2=l2))
    batch = replay.sample(np.random.default_rng(0), 16)
    tensors = observation_tensors(batch)
    with torch.no_grad():
        error = mean_action(policy, tensors).numpy() - batch.labels
    weights = [p for p in actor_parameters(policy) if p.ndim > 0]  # the alphas are scalars
    squares = sum(float(np.square(p.detach().numpy(), dtype=np.float64).sum()) for p in weights)
    expected = np.square(error).sum(axis=1).mean() + l2 * squares
    assert cloning.loss(tensors, torch.from_numpy(batch.labels)).item() == pytest.approx(expected)


def test_bfloat16_changes_a_gradient_by_its_rounding_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gradient of the weights has the same direction, and single precision."""
    replay, policy = filled_replay(50), new_policy()
    batch = replay.sample(np.random.default_rng(0), 64)
    tensors, labels = observation_tensors(batch), torch.from_numpy(batch.labels)
    gradients = []
    for rounds in (False, True):
        monkeypatch.setattr(shortcuts, "_multiplies_bfloat16", lambda rounds=rounds: rounds)
        policy.zero_grad()
        BehaviourCloning(policy, CloningConfig()).loss(tensors, labels).backward()
        parts = [parameter.grad for parameter in actor_parameters(policy)]
        assert all(part is not None and part.dtype == torch.float32 for part in parts)
        gradients.append(torch.cat([part.flatten() for part in parts if part is not None]))
    exact, rounded = gradients
    assert not torch.equal(exact, rounded)
    assert torch.nn.functional.cosine_similarity(exact, rounded, dim=0) > 0.99
    assert (exact - rounded).norm() < 0.1 * exact.norm()


def test_the_mask_learns_but_is_not_pulled_to_zero() -> None:
    """The alphas get their gradient from the imitation error and none from the L2 term."""
    replay, policy = filled_replay(50), new_policy()
    mask = policy.features_extractor.mask
    batch = replay.sample(np.random.default_rng(0), 32)
    tensors, labels = observation_tensors(batch), torch.from_numpy(batch.labels)
    gradients = []
    for l2 in (0.0, 10.0):
        policy.zero_grad()
        BehaviourCloning(policy, CloningConfig(l2=l2)).loss(tensors, labels).backward()
        gradients.append((mask.alpha_speed.grad.item(), mask.alpha_lidar.grad.item()))
    assert gradients[0] == pytest.approx(gradients[1], rel=1e-4)
    assert gradients[0][0] != 0.0
    before = mask.alpha_speed.item()
    BehaviourCloning(policy, CloningConfig()).update(lambda: batch, 3)
    assert mask.alpha_speed.item() != before


def test_gradients_are_clipped() -> None:
    """However wrong the labels, a step's gradient has at most the norm G_max."""
    replay, policy = filled_replay(50), new_policy()
    cloning = BehaviourCloning(policy, CloningConfig(max_grad_norm=1e-12, learning_rate=1.0))
    batch = replay.sample(np.random.default_rng(0), 16)
    before = [p.detach().clone() for p in actor_parameters(policy)]
    cloning.update(lambda: batch, 1)
    # Adam divides by the gradient plus 1e-8: 1e-12 moves nothing far, a real gradient moves by 1.
    moved = max(
        float((p - q).detach().abs().max())
        for p, q in zip(actor_parameters(policy), before, strict=True)
    )
    assert moved < 1e-3


def test_cloning_leaves_the_critic_and_the_exploration_alone() -> None:
    """Only what lies between observation and mean action moves, and no gradient is left behind."""
    replay, policy = filled_replay(50), new_policy()
    others = {
        name: value.clone()
        for name, value in policy.state_dict().items()
        if name.startswith(("value_net", "mlp_extractor.value_net", "log_std"))
    }
    batch = replay.sample(np.random.default_rng(0), 16)
    BehaviourCloning(policy, CloningConfig()).update(lambda: batch, 2)
    assert len(others) == 7
    for name, value in others.items():
        assert torch.equal(policy.state_dict()[name], value)
    assert all(p.grad is None for p in policy.parameters())


def test_the_learning_rate_falls_on_a_plateau(monkeypatch: pytest.MonkeyPatch) -> None:
    """After `patience` updates without progress it is multiplied by `FACTOR`, to its floor."""
    monkeypatch.setattr(behaviour_cloning, "MIN_LEARNING_RATE", 1e-4)
    monkeypatch.setattr(behaviour_cloning, "STEPS_PER_LOOK", 2)
    config = CloningConfig(patience=2)
    cloning = BehaviourCloning(new_policy(), config)
    batch = filled_replay(20).sample(np.random.default_rng(0), 2)
    rates = []
    for _ in range(18):
        cloning.update(lambda: batch, 1)
        cloning.plateau(1.0)
        rates.append(cloning.learning_rate)
    looks = rates[1::2]
    assert looks == pytest.approx([3e-4] * 3 + [1.5e-4] * 3 + [1e-4] * 3)
    assert rates[0::2] == pytest.approx([3e-4, *looks[:-1]])


def test_the_state_continues_the_training() -> None:
    """A copy with weights and state of another takes the same next step."""
    replay = filled_replay(100)
    first, second = new_policy(0), new_policy(1)
    one = BehaviourCloning(first, CloningConfig())
    batches = [replay.sample(np.random.default_rng(k), 16) for k in range(4)]
    one.update(lambda: batches[0], 2)
    two = BehaviourCloning(second, CloningConfig())
    second.load_state_dict(first.state_dict())
    two.load_state_dict(copy.deepcopy(one.state_dict()))
    one.update(lambda: batches[1], 2)
    two.update(lambda: batches[1], 2)
    for p, q in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(p, q)


def test_the_reported_loss_is_that_of_episodes_never_trained_on() -> None:
    """Labels that only held-out episodes have show in the loss."""
    replay = filled_replay(100)
    held_out = replay._data["episode"][:100] % replay.held_out_every == 1
    replay._data["label"][:100][held_out] = 10.0
    cloning = BehaviourCloning(new_policy(), CloningConfig())
    found = cloning.validate(replay, np.random.default_rng(0))
    assert np.mean(list(found.values())) == pytest.approx(100.0, rel=0.1)


def test_without_held_out_states_there_is_no_loss() -> None:
    """An empty validation split reports nothing rather than a zero."""
    replay = filled_replay(20)
    cloning = BehaviourCloning(new_policy(), CloningConfig())
    assert cloning.validate(replay, np.random.default_rng(0)) == {}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("learning_rate", 0.0),
        ("l2", -1.0),
        ("batch_size", 0),
        ("corrected_share", 2.0),
    ],
)
def test_impossible_values_are_refused(key: str, value: float) -> None:
    """The refusal names the key and the value."""
    with pytest.raises(ValueError, match=f"`{key}` must .*Got {value}"):
        CloningConfig(**{key: value})
