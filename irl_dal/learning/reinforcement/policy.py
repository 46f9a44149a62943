"""The policy pi_theta: stable-baselines3's actor and critic on our perception."""

from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.type_aliases import PyTorchObs
from stable_baselines3.common.vec_env import VecTransposeImage
from torch import Tensor, nn

from expert.replay import ReplayBatch
from irl_dal.perception import DrivingFeaturesExtractor, PerceptionConfig

PERCEIVED = "perceived"  # key of features that stand for the observations they were made from

# Units in each of the two hidden layers of a head: stable-baselines3's default. The paper says
# "lightweight MLP head".
HIDDEN = 64


class DrivingPolicy(MultiInputActorCriticPolicy):
    """Actor and critic on shared features, exploring with noise from its own generator.

    Attributes:
        generator: Source of the exploration noise; torch's global one while None.
        perception_gradient: Whether what PPO evaluates sends gradients into the features.
    """

    generator: torch.Generator | None = None
    perception_gradient: bool = True

    def forward(
        self, obs: PyTorchObs, deterministic: bool = False
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Act: actions (B, 2), values (B, 1), log-probabilities (B,)."""
        latent_pi, latent_vf = self.mlp_extractor(self.extract_features(obs))
        distribution = self.action_dist.proba_distribution(self.action_net(latent_pi), self.log_std)
        actions = distribution.mode()
        if not deterministic:
            noise = torch.randn(actions.shape, generator=self.generator)
            actions = actions + self.log_std.exp() * noise
        return actions, self.value_net(latent_vf), distribution.log_prob(actions)

    def evaluate_actions(
        self, obs: PyTorchObs, actions: Tensor
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """What PPO's losses are made of: values (B, 1), log-probabilities (B,), entropies (B,).

        Args:
            obs: A batch of observations, or of what `perceive` made of them.
            actions: (B, 2).
        """
        assert isinstance(obs, dict)
        if PERCEIVED in obs:
            features = obs[PERCEIVED]
        else:
            with torch.set_grad_enabled(torch.is_grad_enabled() and self.perception_gradient):
                features = self.features(obs)
        latent_pi, latent_vf = self.mlp_extractor(features)
        distribution = self.action_dist.proba_distribution(self.action_net(latent_pi), self.log_std)
        log_prob = distribution.log_prob(actions)
        return self.value_net(latent_vf), log_prob, distribution.entropy()

    @torch.no_grad()
    def perceive(
        self, observations: dict[str, NDArray[Any]], batch_size: int = 512
    ) -> dict[str, NDArray[Any]]:
        """Features (N, 512) of N observations (images channels first), in their place.

        Without gradients into the perception they are the same in every epoch of an update.
        """
        parts = []
        for start in range(0, len(observations["speed"]), batch_size):
            rows = {key: value[start : start + batch_size] for key, value in observations.items()}
            parts.append(self.features(self.obs_to_tensor(rows)[0]))
        return {PERCEIVED: torch.cat(parts).numpy()}

    def features(self, obs: PyTorchObs) -> Tensor:
        """What actor and critic share (B, 512)."""
        features = self.extract_features(obs)
        assert isinstance(features, Tensor), "actor and critic share their features"
        return features


def policy_arguments(perception: PerceptionConfig) -> dict[str, Any]:
    """Keyword arguments of `DrivingPolicy`."""
    return {
        "features_extractor_class": DrivingFeaturesExtractor,
        "features_extractor_kwargs": {"config": perception},
        "net_arch": {"pi": [HIDDEN] * 2, "vf": [HIDDEN] * 2},
    }


@torch.no_grad()
def appraise(
    policy: DrivingPolicy, observations: dict[str, NDArray[Any]], actions: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Values (N,) and log-probabilities (N,) of a rollout (images channels first)."""
    seen = {key: torch.from_numpy(v) for key, v in policy.perceive(observations).items()}
    values, log_probs, _ = policy.evaluate_actions(seen, torch.from_numpy(actions))
    return values.flatten().numpy(), log_probs.numpy()


def build_policy(
    observation_space: gymnasium.spaces.Dict,
    action_space: gymnasium.spaces.Box,
    perception: PerceptionConfig,
) -> DrivingPolicy:
    """A policy without PPO in the city's spaces, to load weights into."""
    spaces = dict(observation_space.spaces)
    image = spaces["image"]
    assert isinstance(image, gymnasium.spaces.Box)
    # What PPO's own wrapper does to the space, so that both policies have the same weights.
    spaces["image"] = VecTransposeImage.transpose_space(image, "image")
    with torch.random.fork_rng():
        return DrivingPolicy(
            gymnasium.spaces.Dict(spaces),
            action_space,
            lambda _: 0.0,  # the learning rate of an optimiser that is never used
            **policy_arguments(perception),
        )


def observation_tensors(batch: ReplayBatch) -> dict[str, Tensor]:
    """A replay batch as the policy wants it: images (B, 3, 64, 64), lidar [m], speed [m/s], ..."""
    return {
        "image": torch.from_numpy(batch.images).permute(0, 3, 1, 2),
        "lidar": torch.from_numpy(batch.lidar),
        "speed": torch.from_numpy(batch.speeds),
        "context": torch.from_numpy(batch.contexts),
    }


def mean_action(policy: MultiInputActorCriticPolicy, observation: dict[str, Tensor]) -> Tensor:
    """The policy's mean action (B, 2), normalised, not clipped."""
    return policy.get_distribution(observation).mode()


def actor_parameters(policy: MultiInputActorCriticPolicy) -> list[nn.Parameter]:
    """Every parameter between an observation and the mean action, the mask's alphas included."""
    actor = (policy.features_extractor, policy.mlp_extractor.policy_net, policy.action_net)
    return [parameter for module in actor for parameter in module.parameters()]
