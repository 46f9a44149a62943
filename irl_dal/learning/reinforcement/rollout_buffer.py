"""stable-baselines3's rollout buffer around what several cars have driven, with mixed rewards."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples

from irl_dal.learning.collection.step_record import DrivenStep
from irl_dal.learning.reinforcement.hybrid_reward import HybridReward

__all__ = ["Appraise", "Correction", "HybridRolloutBuffer", "flat"]

Array = NDArray[np.float32]

Appraise = Callable[[dict[str, NDArray[Any]], Array], tuple[Array, Array]]
"""Values (N,) and log-probabilities (N,) of observations and actions (N, 2)."""

Correction = tuple[Array, float]
"""An action (2,) and its log-probability."""


class HybridRolloutBuffer(DictRolloutBuffer):
    """stable-baselines3's rollout buffer with the mixed reward: T steps of each of E cars.

    Rewards are mixed in one batch when the rollout is complete, before returns and advantages are
    computed.

    Behaviour cloning moves the policy while a rollout is collected. `appraise` renews values and
    log-probabilities of the whole rollout, so that PPO's clipping is centred at the policy that the
    update begins with, as in Hilton et al., "Batch size-invariance for policy optimization" (2022);
    advantages of actions that have become less likely are weighted down by the ratio, cut at 1.

    Args:
        hybrid: Mixes the rewards.
        rng: Source of the order of minibatches.
        appraise: Gives values (N,) and log-probabilities (N,) of observations and stored actions
            (N, 2) under the present policy; None keeps what was seen on the way.
        **arguments: Of `DictRolloutBuffer`.
    """

    def __init__(
        self,
        *args: Any,
        hybrid: HybridReward,
        rng: np.random.Generator,
        appraise: Appraise | None = None,
        **arguments: Any,
    ) -> None:
        self.hybrid = hybrid
        self.rng = rng
        self.appraise = appraise
        super().__init__(*args, **arguments)

    def reset(self) -> None:
        """Forget the rollout."""
        super().reset()
        shape = (self.buffer_size, self.n_envs)
        self.env_rewards = np.zeros(shape, np.float32)
        self.imitation_rewards = np.zeros(shape, np.float32)
        self.bootstraps = np.zeros(shape, np.float32)
        self.executed_actions = np.zeros((*shape, 2), np.float32)
        self.drawn_actions = np.zeros((*shape, 2), np.float32)
        self.ends = np.zeros(shape, np.int8)
        self.modes = np.zeros(shape, np.int8)

    def store(self, driven: Sequence[DrivenStep], corrections: Sequence[Correction | None]) -> None:
        """Keep a step of every car.

        Args:
            driven: What the policy drove, car by car.
            corrections: For each, what to keep in place of the policy's own draw, if anything.

        Raises:
            ValueError: If it was not the policy that drove.
        """
        draws = [step.draw for step in driven if step.draw is not None]
        if len(draws) != self.n_envs:
            raise ValueError(f"`driven` must have {self.n_envs} draws. Got {len(draws)}.")
        place = self.pos
        for car, (step, draw) in enumerate(zip(driven, draws, strict=True)):
            self.drawn_actions[place, car] = np.clip(draw.action, -1.0, 1.0)
            self.executed_actions[place, car] = step.transition.command
            self.env_rewards[place, car] = step.transition.reward
            self.bootstraps[place, car] = self.gamma * draw.last_value
            self.ends[place, car] = step.end
            self.modes[place, car] = step.transition.mode
        kept = [
            (draw.action, draw.log_prob) if correction is None else correction
            for draw, correction in zip(draws, corrections, strict=True)
        ]
        super().add(
            {key: np.stack([_seen(step)[key] for step in driven]) for key in self.observations},
            np.stack([action for action, _ in kept]),
            self.env_rewards[place],
            np.array([step.transition.step == 0 for step in driven]),
            torch.tensor([draw.value for draw in draws]),
            torch.tensor([log_prob for _, log_prob in kept]),
        )

    def seen(self) -> dict[str, NDArray[Any]]:
        """Observations of the complete rollout (T E, ...), before it is sampled."""
        return {key: flat(values) for key, values in self.observations.items()}

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: NDArray[Any]) -> None:
        """Mix the rewards, then GAE."""
        shape = (self.buffer_size, self.n_envs)
        observations = self.seen()
        logits = self.hybrid.judge(observations, flat(self.executed_actions))
        if logits is not None:
            self.imitation_rewards = self.hybrid.imitation_reward(logits).reshape(shape)
        correction = np.square(self.executed_actions - self.drawn_actions).sum(axis=-1)
        mixed = self.hybrid.mix(
            self.env_rewards,
            self.imitation_rewards,
            self.ends if logits is not None else np.zeros_like(self.ends),
            correction,
        )
        self.rewards[:] = mixed + self.bootstraps
        weights = self._renew(observations)
        super().compute_returns_and_advantage(last_values, dones)
        self.advantages *= weights

    def _renew(self, observations: dict[str, NDArray[Any]]) -> Array:
        """Renew values and log-probabilities; gives the weights of the advantages (T, E)."""
        shape = (self.buffer_size, self.n_envs)
        if self.appraise is None:
            return np.ones(shape, np.float32)
        values, log_probs = self.appraise(observations, flat(self.actions))
        weights = np.exp(np.minimum(log_probs.reshape(shape) - self.log_probs, 0.0))
        self.values[:], self.log_probs[:] = values.reshape(shape), log_probs.reshape(shape)
        return weights.astype(np.float32)

    def get(  # type: ignore[override]  # as in stable-baselines3's own dictionary buffer
        self, batch_size: int | None = None
    ) -> Generator[DictRolloutBufferSamples, None, None]:
        """Minibatches in an order drawn from `rng`."""
        assert self.full, "a rollout is sampled when it is complete"
        order = self.rng.permutation(self.buffer_size * self.n_envs)
        if not self.generator_ready:
            for key, values in self.observations.items():
                self.observations[key] = self.swap_and_flatten(values)
            for name in ("actions", "values", "log_probs", "advantages", "returns"):
                self.__dict__[name] = self.swap_and_flatten(self.__dict__[name])
            self.generator_ready = True
        size = batch_size or len(order)
        for start in range(0, len(order), size):
            yield self._get_samples(order[start : start + size])


def _seen(step: DrivenStep) -> dict[str, NDArray[Any]]:
    """With the image channels first, as the policy takes it."""
    return {**step.seen, "image": step.seen["image"].transpose(2, 0, 1)}


def flat(values: NDArray[Any]) -> NDArray[Any]:
    """(T, E, ...) as (T E, ...)."""
    return values.reshape(-1, *values.shape[2:])
