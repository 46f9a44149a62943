"""Training of the planner's denoiser."""

import copy

import numpy as np
import pytest
import torch

from irl_dal.learning.imitation import diffusion_training
from irl_dal.learning.imitation.diffusion_training import DiffusionTraining, DiffusionTrainingConfig
from irl_dal.planner import DiffusionPlanner, PlannerConfig
from shield import ActuatorLimits
from tests.irl_dal.learning.samples import filled_replay


def new_training(seed: int = 0, **arguments: float) -> DiffusionTraining:
    """A small planner and its training."""
    config = PlannerConfig(width=16)
    generator = torch.Generator().manual_seed(seed)
    planner = DiffusionPlanner(config, ActuatorLimits(), generator=generator)
    settings = {"batch_size": 64} | arguments
    training = DiffusionTrainingConfig(**settings)
    return DiffusionTraining(planner, training, np.random.default_rng(seed))


def test_training_lowers_the_held_out_loss() -> None:
    """A hundred gradient steps on the expert's chunks more than halve it."""
    replay, training = filled_replay(400), new_training()
    before = training.validate(replay)
    training.update(replay, 100)
    after = training.validate(replay)
    assert before is not None and after is not None
    assert after < 0.5 * before


def test_the_planning_network_carries_the_average_of_the_weights(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Against a recomputation of the moving average from the weights after each single step."""
    replay = filled_replay(100)
    one, many = new_training(), new_training()
    average = copy.deepcopy(many.planner.denoiser.state_dict())
    for step in range(1, 16):
        monkeypatch.setattr(diffusion_training, "AVERAGE_DECAY", 0.0)
        one.update(replay, 1)
        decay = min(0.9, step / (step + 10.0))
        newest = one.planner.denoiser.state_dict()
        average = {k: decay * average[k] + (1 - decay) * newest[k] for k in average}
    monkeypatch.setattr(diffusion_training, "AVERAGE_DECAY", 0.9)
    many.update(replay, 15)
    for name, value in many.planner.denoiser.state_dict().items():
        assert torch.allclose(value, average[name], atol=1e-5)


def test_the_state_continues_the_training() -> None:
    """A copy with the state of another takes the same next steps, noise included."""
    replay = filled_replay(100)
    one, two = new_training(0), new_training(1)
    one.update(replay, 3)
    two.load_state_dict(copy.deepcopy(one.state_dict()))
    losses = []
    for training in (one, two):
        training._rng = np.random.default_rng(9)
        losses.append(training.update(replay, 3))
    assert losses[0] == losses[1]
    for name, value in one.planner.denoiser.state_dict().items():
        assert torch.equal(value, two.planner.denoiser.state_dict()[name])


def test_without_held_out_chunks_there_is_no_loss() -> None:
    """An empty validation split reports nothing and leaves the learning rate alone."""
    training = new_training()
    assert training.validate(filled_replay(20)) is None
    assert training.learning_rate == 1e-3


@pytest.mark.parametrize(
    ("key", "value"), [("learning_rate", 0.0), ("batch_size", 0), ("steps_mixed", -1)]
)
def test_impossible_values_are_refused(key: str, value: float) -> None:
    """The refusal names the key and the value."""
    with pytest.raises(ValueError, match=f"`{key}` must .*Got {value}"):
        DiffusionTrainingConfig(**{key: value})
