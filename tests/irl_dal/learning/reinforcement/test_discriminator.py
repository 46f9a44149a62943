"""The GAIL discriminator."""

import copy

import numpy as np
import pytest
import torch
from torch import Tensor

from irl_dal.learning.reinforcement.discriminator import (
    Discriminator,
    DiscriminatorConfig,
    discriminator_loss,
)
from irl_dal.learning.reinforcement.policy import observation_tensors
from tests.irl_dal.learning.samples import filled_replay, new_policy

Pairs = tuple[dict[str, Tensor], Tensor]


def new_discriminator(seed: int = 0, **arguments: float) -> Discriminator:
    """A discriminator on a fresh policy's perception."""
    settings = {"steps": 150, "learning_rate": 2e-3} | arguments
    config = DiscriminatorConfig(**settings)
    return Discriminator(new_policy(), config, torch.Generator().manual_seed(seed))


def both_sides(wrong: float) -> tuple[Pairs, Pairs]:
    """Pairs of the expert and of an agent that is off by `wrong` in both components."""
    replay = filled_replay(400)
    sides = []
    for seed, offset in ((0, 0.0), (1, wrong)):
        batch = replay.sample(np.random.default_rng(seed), 256)
        actions = torch.from_numpy(batch.commands + np.float32(offset))
        sides.append((observation_tensors(batch), actions))
    return sides[0], sides[1]


def test_expert_pairs_get_positive_logits() -> None:
    """The sign convention: after training, D is near 1 for the expert and near 0 for the agent."""
    expert, agent = both_sides(wrong=1.0)
    discriminator = new_discriminator()
    report = discriminator.update(expert, agent)
    assert report["accuracy"] > 0.9
    assert report["expert_logit"] > 1.0
    assert report["agent_logit"] < -1.0
    kept = {key: values[::5] for key, values in expert[0].items()}, expert[1][::5]
    assert discriminator.judge(*kept).mean().item() == pytest.approx(
        report["expert_logit"], abs=1e-4
    )
    assert discriminator.updates == 1


def test_an_agent_that_drives_as_the_expert_cannot_be_told_apart() -> None:
    """The same kind of pairs on both sides: on those kept out, accuracy is that of a coin."""
    report = new_discriminator().update(*both_sides(wrong=0.0))
    assert 0.35 < report["accuracy"] < 0.65


def test_the_loss_is_the_papers_equation() -> None:
    """Binary cross-entropy from logits equals the printed expectation of logarithms."""
    expert, agent = torch.tensor([2.0, -0.5]), torch.tensor([0.3, -3.0])
    printed = -torch.log(1 - torch.sigmoid(agent)).mean() - torch.log(torch.sigmoid(expert)).mean()
    assert discriminator_loss(expert, agent).item() == pytest.approx(printed.item(), rel=1e-6)


def test_training_leaves_the_perception_as_it_is() -> None:
    """Neither the frozen copy nor the policy's own extractor moves."""
    policy = new_policy()
    discriminator = Discriminator(
        policy, DiscriminatorConfig(steps=5), torch.Generator().manual_seed(0)
    )
    before = {k: v.clone() for k, v in policy.features_extractor.state_dict().items()}
    features = discriminator.features(both_sides(0.0)[0][0])
    discriminator.update(*both_sides(1.0))
    after = policy.features_extractor.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert torch.equal(discriminator.features(both_sides(0.0)[0][0]), features)


def test_sync_copies_the_policys_perception() -> None:
    """Until SyncFeatures the discriminator sees with the old perception, then with the new."""
    discriminator, newer = new_discriminator(), new_policy(seed=5)
    seen = both_sides(0.0)[0][0]
    with torch.no_grad():
        wanted = newer.extract_features(seen)
    assert not torch.allclose(discriminator.features(seen), wanted)
    discriminator.sync_features(newer)
    assert torch.allclose(discriminator.features(seen), wanted, atol=1e-6)


def test_same_generator_same_training_and_state_continues_it() -> None:
    """Weights, batches and noise come from the generator; a restored copy goes on identically."""
    expert, agent = both_sides(0.5)
    first, second, third = (new_discriminator(seed, steps=5) for seed in (3, 3, 4))
    for discriminator in (first, second, third):
        discriminator.update(expert, agent)
    assert torch.equal(first.judge(*agent), second.judge(*agent))
    assert not torch.equal(first.judge(*agent), third.judge(*agent))
    third.load_state_dict(copy.deepcopy(first.state_dict()))
    first.update(expert, agent)
    third.update(expert, agent)
    assert torch.equal(first.judge(*agent), third.judge(*agent))


def test_the_global_random_state_is_left_alone() -> None:
    """Building and training draw nothing from torch's global generator."""
    before = torch.get_rng_state()
    new_discriminator(steps=2).update(*both_sides(0.5))
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize(("key", "value"), [("steps", 0), ("learning_rate", -1.0), ("samples", -1)])
def test_impossible_values_are_refused(key: str, value: float) -> None:
    """The refusal names the key and the value."""
    with pytest.raises(ValueError, match=f"`{key}` must .*Got {value}"):
        DiscriminatorConfig(**{key: value})
