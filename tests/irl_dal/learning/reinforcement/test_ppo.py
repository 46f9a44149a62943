"""PPO around the cloned policy."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv
from torch.distributions import Independent, Normal, kl_divergence

from irl_dal.learning.imitation.behaviour_cloning import BehaviourCloning, CloningConfig
from irl_dal.learning.reinforcement.hybrid_reward import HybridReward, HybridRewardConfig
from irl_dal.learning.reinforcement.policy import PERCEIVED, DrivingPolicy, actor_parameters
from irl_dal.learning.reinforcement.ppo import (
    LOWEST_ACTOR_RATE,
    ActorCriticAdam,
    DrivingPPO,
    PPOConfig,
    build_ppo,
    divergence,
)
from irl_dal.perception import PerceptionConfig
from tests.irl_dal.learning.samples import (
    ACTION_SPACE,
    OBSERVATION_SPACE,
    filled_replay,
    observation,
    record,
)


class Samples(gymnasium.Env[Any, Any]):
    """Random observations of the city's spaces; the reward is minus ten times the first action."""

    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def reset(self, **_: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Some observation."""
        return observation(self._rng), {}

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Another one."""
        return observation(self._rng), float(-10.0 * action[0]), False, False, {}


class Note(BaseCallback):
    """Notes the steps as the pipeline does, and keeps the last values."""

    def _on_step(self) -> bool:
        seen = observation(np.random.default_rng(0))
        ppo = self.model
        assert isinstance(ppo, DrivingPPO)
        ppo.rollout_buffer.note([record(seen, float(self.locals["rewards"][0]))])
        return True

    def _on_rollout_end(self) -> None:
        ppo = self.model
        assert isinstance(ppo, DrivingPPO)
        reward = HybridReward(HybridRewardConfig(), ppo.gamma)
        ppo.rollout_buffer.finish(reward, None, None, self.locals["values"])


def new_ppo(cloning_steps: int = 0, **arguments: Any) -> DrivingPPO:
    """PPO with a complete rollout of 64 steps, collected by stable-baselines3."""
    config = PPOConfig(n_steps=64, batch_size=16, n_epochs=2, **arguments)
    rng = np.random.default_rng(0)
    ppo = build_ppo(DummyVecEnv([Samples]), config, PerceptionConfig(), weights=rng, order=rng)
    ppo.set_logger(Logger(None, []))
    replay = filled_replay(100)
    cloning = BehaviourCloning(ppo.policy, CloningConfig(learning_rate=1e-3))
    cloning.update(lambda: replay.sample(rng, 32), cloning_steps)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DrivingPPO, "train", lambda _: None)
        ppo.learn(64, Note(), log_interval=2)
    return ppo


def trained(ppo: DrivingPPO) -> tuple[set[str], dict[str, float]]:
    """Which parameters an update moves, and what it records."""
    before = {name: value.detach().clone() for name, value in ppo.policy.named_parameters()}
    ppo.train()
    after = dict(ppo.policy.named_parameters())
    moved = {name for name, value in before.items() if not torch.equal(value, after[name])}
    return moved, dict(ppo.logger.name_to_value)


def test_an_update_moves_the_heads_and_leaves_the_perception_to_cloning() -> None:
    """Actor head, noise and critic learn; the features do not, unless they are asked to."""
    moved, _ = trained(new_ppo())
    assert not [name for name in moved if "features_extractor" in name]
    assert {"action_net.weight", "value_net.weight", "log_std"} <= moved
    moved, _ = trained(new_ppo(perception_gradient=True))
    assert [name for name in moved if "features_extractor" in name]


def test_table_2s_rate_alone_tears_the_cloned_policy_away() -> None:
    """One update of PPO as it comes diverges more than ten times as far as one of ours."""
    _, ours = trained(new_ppo(cloning_steps=30))
    _, plain = trained(new_ppo(cloning_steps=30, target_kl=None, perception_gradient=True))
    assert ours["train/divergence"] < 0.1
    assert plain["train/divergence"] > 10.0 * ours["train/divergence"]


def test_the_actor_has_a_rate_of_its_own_and_the_critic_that_of_table_2() -> None:
    """Two parameter groups; together they are all parameters, each once."""
    ppo = new_ppo()
    ppo.optimizer.actor_rate = 2e-5
    ppo.train()
    actor, critic = ppo.policy.optimizer.param_groups
    assert (actor["lr"], critic["lr"]) == (2e-5, 3e-4)
    assert len(actor["params"]) + len(critic["params"]) == len(list(ppo.policy.parameters()))
    ids = {id(parameter) for parameter in actor["params"]}
    assert {id(parameter) for parameter in actor_parameters(ppo.policy)} <= ids


def test_the_rate_follows_the_divergence_between_floor_and_ceiling() -> None:
    """Halved when an update went too far, doubled when it fell short, kept in between."""
    weights = [torch.nn.Parameter(torch.zeros(2))], [torch.nn.Parameter(torch.zeros(2))]
    adam, values = ActorCriticAdam(*weights, PPOConfig(target_kl=0.02)), []
    for measured in (0.5, 0.02, 0.001, 0.001, 0.001):
        adam.follow(measured)
        values.append(adam.actor_rate)
    assert values == pytest.approx([5e-5, 5e-5, 1e-4, 2e-4, 3e-4])
    for _ in range(30):
        adam.follow(1.0)
    assert adam.actor_rate == LOWEST_ACTOR_RATE
    fixed = ActorCriticAdam(*weights, PPOConfig(target_kl=None))
    fixed.follow(1.0)
    assert fixed.actor_rate == 3e-4


def test_the_divergence_is_that_of_torchs_own_gaussians() -> None:
    """Against torch.distributions, for random means and spreads."""
    generator = torch.Generator().manual_seed(0)
    means = torch.randn(2, 50, 2, generator=generator)
    spreads = torch.rand(2, 2, generator=generator) + 0.1
    pair = [Independent(Normal(means[k], spreads[k]), 1) for k in range(2)]
    expected = kl_divergence(pair[0], pair[1]).mean().item()
    found = divergence((means[0], spreads[0]), (means[1], spreads[1]))
    assert found == pytest.approx(expected, rel=1e-4)


def test_the_same_generator_builds_the_same_ppo() -> None:
    """Weights come from the generator handed in, not from torch's global one."""
    first, second = new_ppo().policy.state_dict(), new_ppo().policy.state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)


def features(policy: DrivingPolicy, seen: Any) -> torch.Tensor:
    """Of observations, without a gradient."""
    with torch.no_grad():
        perceived = policy.extract_features(seen)
    assert isinstance(perceived, torch.Tensor)
    return perceived


def test_a_shorter_rollout_is_collected_whole() -> None:
    """The last update of a run has the steps that are left."""
    ppo = new_ppo()
    ppo.resize(12)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DrivingPPO, "train", lambda _: None)
        ppo.learn(12, Note(), log_interval=2, reset_num_timesteps=False)
    assert ppo.num_timesteps == 76
    assert ppo.rollout_buffer.full and len(ppo.rollout_buffer.actions) == 12
    ppo.train()


def test_perceiving_a_rollout_once_changes_nothing_but_the_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same weights as an update that looks at the images again in every epoch."""
    once, again = new_ppo(), new_ppo()
    once.train()
    assert set(once.rollout_buffer.observations) == {PERCEIVED}
    # As with gradients into the perception, which then must not flow.
    again.policy.perception_gradient = True
    monkeypatch.setattr(again.policy, "features", lambda seen: features(again.policy, seen))
    again.train()
    assert "image" in again.rollout_buffer.observations
    for name, value in again.policy.state_dict().items():
        torch.testing.assert_close(once.policy.state_dict()[name], value, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize(
    ("key", "value"),
    [("target_kl", 0.0), ("n_steps", 0), ("gamma", 1.0), ("gae_lambda", 1.5), ("clip_range", 0.0)],
)
def test_impossible_values_are_refused(key: str, value: float) -> None:
    """The refusal names the key and the value."""
    with pytest.raises(ValueError, match=f"`{key}` must .*Got {value}"):
        PPOConfig(**{key: value})
