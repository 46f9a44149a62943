"""stable-baselines3's rollout buffer with the mixed reward."""

from collections.abc import Generator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples

from irl_dal.learning.collection.recorder import EpisodeEnd, StepRecord
from irl_dal.learning.reinforcement.hybrid_reward import HybridReward

Array = NDArray[np.float32]

# Fields of a minibatch after the observations, in stable-baselines3's order.
FLATTENED = ("actions", "values", "log_probs", "advantages", "returns")


class HybridRolloutBuffer(DictRolloutBuffer):
    """T steps of each of E cars; rewards are mixed in one batch when the rollout is complete.

    stable-baselines3 fills it (`add`); `note` adds what it does not know of a step, and `finish`
    computes returns and advantages of the mixed rewards.

    Behaviour cloning moves the policy while a rollout is collected. `finish` therefore takes values
    and log-probabilities under the present policy, so that PPO's clipping is centred at the policy
    that the update begins with, as in Hilton et al., "Batch size-invariance for policy
    optimization" (2022); advantages of actions that have become less likely are weighted down by
    the ratio, cut at 1.

    `rng` draws the order of minibatches; the other arguments are `DictRolloutBuffer`'s.
    """

    def __init__(self, *args: Any, rng: np.random.Generator, **arguments: Any) -> None:
        self.rng = rng
        super().__init__(*args, **arguments)

    def reset(self) -> None:
        """Forget the rollout."""
        super().reset()
        shape = (self.buffer_size, self.n_envs)
        self.env_rewards, self.imitation_rewards = np.zeros((2, *shape), np.float32)
        self.executed_actions = np.zeros((*shape, 2), np.float32)
        self.ends, self.modes = np.zeros((2, *shape), np.int8)

    def note(self, records: Sequence[StepRecord]) -> None:
        """Keep what is known of a step of every car, before stable-baselines3 adds the step."""
        self.env_rewards[self.pos] = [record.transition.reward for record in records]
        self.executed_actions[self.pos] = [record.transition.command for record in records]
        self.ends[self.pos] = [record.end for record in records]
        self.modes[self.pos] = [record.transition.mode for record in records]

    def seen(self) -> dict[str, NDArray[Any]]:
        """Observations of the complete rollout (T E, ...), before it is sampled."""
        return {key: flat(values) for key, values in self.observations.items()}

    def finish(
        self,
        reward: HybridReward,
        logits: Array | None,
        renewed: tuple[Array, Array] | None,
        last_values: torch.Tensor,
    ) -> None:
        """Mix the rewards, then GAE.

        Args:
            reward: Mixes.
            logits: Expert logits (T E,) of the executed actions; None while the discriminator is
                untrained: r_irl is then 0, at the ends of episodes too.
            renewed: Values and log-probabilities (T E,) of the stored actions under the present
                policy; None keeps those of the policy that acted.
            last_values: Values (E, 1) of what each car sees after its last step.
        """
        shape = (self.buffer_size, self.n_envs)
        # What stable-baselines3 adds to the reward where the time is up: gamma times the value.
        bootstraps = self.rewards - self.env_rewards
        ends = np.zeros_like(self.ends)
        if logits is not None:
            self.imitation_rewards = reward.imitation_reward(logits).reshape(shape)
            ends = self.ends
        self.rewards[:] = reward.mix(self.env_rewards, self.imitation_rewards, ends) + bootstraps
        weights: Array = np.ones(shape, np.float32)
        if renewed is not None:
            values, log_probs = (values.reshape(shape) for values in renewed)
            weights = np.exp(np.minimum(log_probs - self.log_probs, 0.0)).astype(np.float32)
            self.values[:], self.log_probs[:] = values, log_probs
        over = self.ends[-1] != EpisodeEnd.GOES_ON
        self.compute_returns_and_advantage(last_values, over)
        self.advantages *= weights

    def get(  # type: ignore[override]  # as in stable-baselines3's own dictionary buffer
        self, batch_size: int | None = None
    ) -> Generator[DictRolloutBufferSamples, None, None]:
        """Minibatches in an order drawn from `rng`, a car's steps after another's."""
        assert self.full, "a rollout is sampled when it is complete"
        order = self.rng.permutation(self.buffer_size * self.n_envs)
        if not self.generator_ready:
            self.observations = {k: self.swap_and_flatten(v) for k, v in self.observations.items()}
            for name in FLATTENED:
                setattr(self, name, self.swap_and_flatten(getattr(self, name)))
            self.generator_ready = True
        size = batch_size or len(order)
        for start in range(0, len(order), size):
            rows = order[start : start + size]
            seen = {k: self.to_torch(v[rows]) for k, v in self.observations.items()}
            actions, *others = (self.to_torch(getattr(self, name)[rows]) for name in FLATTENED)
            yield DictRolloutBufferSamples(seen, actions, *(part.flatten() for part in others))


def flat(values: NDArray[Any]) -> NDArray[Any]:
    """(T, E, ...) as (T E, ...)."""
    return values.reshape(-1, *values.shape[2:])
