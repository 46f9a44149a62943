"""stable-baselines3's PPO, with steps that leave what was cloned in place.

The exploration noise is small, so that a policy that drives goes on driving. A small change of the
mean action is then a large divergence, and PPO as it comes (Table II: learning rate 3e-4, all
parameters) moves the mean by 0.2 within one update: 40 noise deviations, and the end of what was
cloned. Three things keep it near, none of them in the paper:

* its gradients stop at the shared features: those belong to behaviour cloning
  (`perception_gradient`);
* the actor's learning rate follows the divergence of the last update, as in Rudin et al., "Learning
  to walk in minutes" (2021), with Table II's rate as the ceiling; the critic keeps that rate;
* values and log-probabilities are renewed before an update (see `HybridRolloutBuffer`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from irl_dal.learning.collection.step_record import End
from irl_dal.learning.reinforcement.policy import DrivingPolicy, PPOConfig, policy_arguments
from irl_dal.learning.reinforcement.rollout_buffer import HybridRolloutBuffer
from irl_dal.perception import PerceptionConfig

__all__ = ["ActorRate", "DrivingPPO", "build_ppo", "divergence"]

SAMPLES = 256
"""Observations on which the divergence of an update is measured."""


@dataclass(slots=True)
class ActorRate:
    """Learning rate of the actor.

    Attributes:
        value: Present rate.
        ceiling: Largest rate.
        target: Divergence that one update should have; None leaves the rate at the ceiling.
        floor: Smallest rate.
    """

    value: float
    ceiling: float
    target: float | None
    floor: float = 1e-7

    def __post_init__(self) -> None:
        if self.target is None:
            self.value = self.ceiling

    def follow(self, measured: float) -> None:
        """Double or halve the rate after an update whose divergence was far from the target."""
        if self.target is None:
            return
        if measured > 1.5 * self.target:
            self.value = max(self.value / 2.0, self.floor)
        elif measured < self.target / 1.5:
            self.value = min(self.value * 2.0, self.ceiling)


class DrivingPPO(PPO):
    """PPO on a `DrivingPolicy`, with a learning rate of its own for the actor.

    Attributes:
        actor_rate: Set by `build_ppo`.
    """

    actor_rate: ActorRate

    def begin_rollout(self, size: int) -> HybridRolloutBuffer:
        """An empty buffer for so many steps of each car."""
        buffer = self.rollout_buffer
        assert isinstance(buffer, HybridRolloutBuffer)
        if size != buffer.buffer_size:
            buffer = self.rollout_buffer = HybridRolloutBuffer(
                size,
                self.observation_space,
                self.action_space,
                device=self.device,
                n_envs=self.n_envs,
                gamma=self.gamma,
                gae_lambda=self.gae_lambda,
                **self.rollout_buffer_kwargs,
            )
        buffer.reset()
        return buffer

    @torch.no_grad()
    def end_rollout(self, seen: dict[str, NDArray[Any]], over: NDArray[np.bool_]) -> None:
        """Returns and advantages of the complete rollout.

        Args:
            seen: What each of the E cars sees after its last step, batched.
            over: Whether that step ended an episode (E,).
        """
        buffer = self.rollout_buffer
        assert isinstance(buffer, HybridRolloutBuffer)
        last, _ = self.policy.obs_to_tensor(seen)
        buffer.compute_returns_and_advantage(self.policy.predict_values(last), over)
        self.logger.record("reward/env", float(buffer.env_rewards.mean()))
        self.logger.record("reward/imitation", float(buffer.imitation_rewards.mean()))
        self.logger.record("reward/failures", int((buffer.ends == End.FAILURE).sum()))

    def train(self) -> None:
        """Update actor and critic from the rollout; then let the actor's rate follow."""
        policy = driving_policy(self)
        seen = self._some_observations()
        before = _gaussian(policy, seen)
        if not policy.perception_gradient:
            self._perceive_once(policy)
        super().train()
        measured = divergence(before, _gaussian(policy, seen))
        self.logger.record("train/divergence", measured)
        self.logger.record("train/actor_rate", self.actor_rate.value)
        self.actor_rate.follow(measured)

    def _update_learning_rate(
        self, optimizers: list[torch.optim.Optimizer] | torch.optim.Optimizer
    ) -> None:
        super()._update_learning_rate(optimizers)
        actor, _critic = self.policy.optimizer.param_groups
        actor["lr"] = self.actor_rate.value

    def _perceive_once(self, policy: DrivingPolicy) -> None:
        """Put features into the place of the rollout's images, which no epoch needs again."""
        buffer = self.rollout_buffer
        assert isinstance(buffer, HybridRolloutBuffer)
        shape = (buffer.buffer_size, buffer.n_envs)
        seen = policy.perceive(buffer.seen())
        buffer.observations = {k: v.reshape(*shape, *v.shape[1:]) for k, v in seen.items()}

    def _some_observations(self) -> dict[str, Tensor]:
        buffer = self.rollout_buffer
        assert isinstance(buffer, HybridRolloutBuffer)
        steps = buffer.buffer_size * buffer.n_envs
        rows = np.linspace(0, steps - 1, min(SAMPLES, steps)).astype(int)
        return {
            key: torch.from_numpy(values[rows]).to(self.device)
            for key, values in buffer.seen().items()
        }


def divergence(before: tuple[Tensor, Tensor], after: tuple[Tensor, Tensor]) -> float:
    """Mean Kullback-Leibler divergence of diagonal Gaussians, KL(before || after).

    Args:
        before: Means (N, 2) and standard deviations (2,).
        after: The same.
    """
    (old, old_std), (new, new_std) = before, after
    ratio = (old_std.square() + (old - new).square()) / (2.0 * new_std.square())
    return float((torch.log(new_std / old_std) + ratio - 0.5).sum(dim=1).mean())


def driving_policy(ppo: PPO) -> DrivingPolicy:
    """The policy of a PPO that `build_ppo` made."""
    assert isinstance(ppo.policy, DrivingPolicy)
    return ppo.policy


def build_ppo(
    env: VecEnv,
    config: PPOConfig,
    perception: PerceptionConfig,
    *,
    rng: np.random.Generator,
    buffer_arguments: Mapping[str, Any],
    device: str = "cpu",
) -> DrivingPPO:
    """PPO around our policy and rollout buffer, initialised from `rng`.

    Args:
        env: The cars, which share `n_steps` of the configuration evenly.
        config: Of the update.
        perception: Of the policy.
        rng: Source of the first weights.
        buffer_arguments: Of `HybridRolloutBuffer`.
        device: Where the policy is.
    """
    # The networks draw their first weights from torch's global generator: lend it a seed of ours.
    with torch.random.fork_rng():
        torch.manual_seed(int(rng.integers(2**63)))
        ppo = DrivingPPO(
            DrivingPolicy,
            env,
            learning_rate=config.learning_rate,
            n_steps=config.n_steps // env.num_envs,
            batch_size=config.batch_size,
            n_epochs=config.n_epochs,
            gamma=config.gamma,
            gae_lambda=config.gae_lambda,
            clip_range=config.clip_range,
            ent_coef=config.ent_coef,
            vf_coef=config.vf_coef,
            max_grad_norm=config.max_grad_norm,
            rollout_buffer_class=HybridRolloutBuffer,
            rollout_buffer_kwargs=dict(buffer_arguments),
            policy_kwargs=policy_arguments(config, perception),
            device=device,
        )
    policy = driving_policy(ppo)
    policy.perception_gradient = config.perception_gradient
    with torch.no_grad():
        policy.log_std.copy_(torch.tensor(config.initial_log_std))
    policy.optimizer = _two_rates(policy, config)
    ppo.actor_rate = ActorRate(config.initial_actor_rate, config.learning_rate, config.target_kl)
    return ppo


def _two_rates(policy: DrivingPolicy, config: PPOConfig) -> torch.optim.Optimizer:
    """PPO's Adam with the actor's parameters (the perception's too) and the critic's apart."""
    critic = [*policy.mlp_extractor.value_net.parameters(), *policy.value_net.parameters()]
    known = {id(parameter) for parameter in critic}
    actor = [parameter for parameter in policy.parameters() if id(parameter) not in known]
    groups = [{"params": actor}, {"params": critic}]
    # stable-baselines3's epsilon.
    return torch.optim.Adam(groups, lr=config.learning_rate, eps=1e-5, fused=True)


@torch.no_grad()
def _gaussian(policy: DrivingPolicy, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    return policy.get_distribution(seen).mode(), policy.log_std.exp().clone()
