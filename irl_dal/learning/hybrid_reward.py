"""The hybrid reward r = w_env r_env + w_irl r_irl (Eq. hybrid_reward), mixed per rollout.

| here | paper |
|---|---|
| `expert_logit` | log D_psi - log(1 - D_psi), D -> 1 for the expert |
| `imitation_reward` | r_irl(s_t, a_t), a_t as executed |
| `HybridRolloutBuffer.env_rewards`, `.imitation_rewards` | r_env, r_irl |
| `HybridRolloutBuffer.rewards` | r_t |

Two forms of r_irl. `printed` is -log(1 - D + eps) clipped to [r_min, r_max]: never negative, so
that the agent is paid for every step by which it puts off the goal. `centred` (default) is the
logit, scaled and clipped to [-1, 1]: zero where the discriminator cannot tell the two apart.

Ends of episodes. A reward that stops at the end of an episode makes ending it worth something of
its own: with r_irl < 0 a crash would be a relief. So r_irl goes on after the end, as if in an
absorbing state (Kostrikov et al., "Discriminator-Actor-Critic", 2019): at its lower bound after a
failure, which can then never be better than driving on, and at the rollout's mean after a success,
which neither pays nor costs. Time limits are bootstrapped with the critic, by stable-baselines3.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples

from expert.modes import Mode

__all__ = [
    "End",
    "HybridReward",
    "HybridRewardConfig",
    "HybridRolloutBuffer",
    "StepOutcome",
    "flat",
]

Array = NDArray[np.float32]
Appraise = Callable[[dict[str, NDArray[Any]], Array], tuple[Array, Array]]
Judge = Callable[[dict[str, NDArray[Any]], Array], Array | None]
ImitationForm = Literal["centred", "printed"]


class End(IntEnum):
    """How a step left its episode."""

    GOES_ON = 0
    SUCCESS = 1
    FAILURE = 2
    TIME_LIMIT = 3


@dataclass(frozen=True, slots=True)
class HybridRewardConfig:
    """Weights and forms.

    Attributes:
        w_env: Weight of the environment's reward (Table II).
        w_irl: Weight of the discriminator's reward (Table II).
        form: `centred` or `printed`.
        logit_scale: Logit that is worth a `centred` reward of 1; 4 is D = 0.982.
        epsilon: Of the printed form.
        r_min: Lower bound of the printed form ("a predefined range"; the paper gives no numbers).
        r_max: Upper bound of the printed form.
        absorbing: Let r_irl go on after the end of an episode.
        correction_penalty: Loss for each squared unit (normalised) by which planner and shield
            changed the action: several actions that are corrected to the same one should not look
            alike (arXiv 2509.12833). 0 switches it off.
        unit_returns: Multiply by 1 - gamma, so that returns are of the size of one reward and the
            value loss does not drown the policy's gradient in the shared features.

    Raises:
        ValueError: If the weights are not a convex combination, or a bound cannot be meant.
    """

    w_env: float = 0.7
    w_irl: float = 0.3
    form: ImitationForm = "centred"
    logit_scale: float = 4.0
    epsilon: float = 1e-8
    r_min: float = 0.0
    r_max: float = 5.0
    absorbing: bool = True
    correction_penalty: float = 0.0
    unit_returns: bool = True

    def __post_init__(self) -> None:
        if min(self.w_env, self.w_irl) < 0.0 or abs(self.w_env + self.w_irl - 1.0) > 1e-9:
            raise ValueError(
                f"`w_env` and `w_irl` must be >= 0 and add to 1. Got {self.w_env}, {self.w_irl}."
            )
        if self.form not in get_args(ImitationForm):
            raise ValueError(f"`form` must be one of {get_args(ImitationForm)}. Got {self.form!r}.")
        if not self.r_min < self.r_max:
            raise ValueError(f"`r_min` must be below `r_max`. Got {self.r_min} and {self.r_max}.")
        for name in ("logit_scale", "epsilon"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"`{name}` must be positive. Got {getattr(self, name)}.")
        if self.correction_penalty < 0.0:
            raise ValueError(
                f"`correction_penalty` must not be negative. Got {self.correction_penalty}."
            )


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """What the rollout buffer must know of a car's step beside stable-baselines3's five things.

    Attributes:
        env_reward: r_env.
        executed_action: What reached the actuators (2,), normalised.
        end: Whether and how the step ended its episode.
        mode: FSM state of the expert in the state acted upon.
        stored_action: Action to keep in place of the policy's own draw (2,), and its
            log-probability: only `saec: paper` has any.
    """

    env_reward: float
    executed_action: Array
    end: End
    mode: Mode = Mode.LANE_FOLLOWING
    stored_action: tuple[Array, float] | None = None


@dataclass(frozen=True, slots=True)
class HybridReward:
    """Mixes the two rewards.

    Attributes:
        config: Weights and forms.
        gamma: Discount factor.
        judge: Gives the expert logits (N,) for observations and executed actions (N, 2), or None
            while the discriminator is untrained.
    """

    config: HybridRewardConfig
    gamma: float
    judge: Judge

    @property
    def scale(self) -> float:
        """What every reward is multiplied with before the critic sees it."""
        return 1.0 - self.gamma if self.config.unit_returns else 1.0

    @property
    def worst(self) -> float:
        """Lower bound of r_irl."""
        return -1.0 if self.config.form == "centred" else self.config.r_min

    def imitation_reward(self, expert_logit: Array) -> Array:
        """r_irl for logits of any shape."""
        config = self.config
        if config.form == "centred":
            return np.clip(expert_logit / config.logit_scale, -1.0, 1.0).astype(np.float32)
        other = 1.0 / (1.0 + np.exp(np.clip(expert_logit, -60.0, 60.0).astype(np.float64)))
        printed = -np.log(other + config.epsilon)  # Eq. gail_reward, 1 - D = other
        return np.clip(printed, config.r_min, config.r_max).astype(np.float32)

    def continuation(self, ends: NDArray[np.int8], imitation: Array) -> Array:
        """What r_irl is worth after each step: zero except where an episode ends for good."""
        if not self.config.absorbing or not imitation.size:
            return np.zeros_like(imitation)
        for_ever = self.gamma / (1.0 - self.gamma)
        after = np.where(ends == End.FAILURE, self.worst, float(imitation.mean())) * for_ever
        ended = (ends == End.FAILURE) | (ends == End.SUCCESS)
        return np.where(ended, after, 0.0).astype(np.float32)

    def mix(self, env: Array, imitation: Array, ends: NDArray[np.int8], correction: Array) -> Array:
        """Eq. hybrid_reward, scaled; `correction` is the squared change of the action."""
        config = self.config
        imitated = imitation + self.continuation(ends, imitation)
        mixed = config.w_env * env + config.w_irl * imitated
        return (self.scale * (mixed - config.correction_penalty * correction)).astype(np.float32)


class HybridRolloutBuffer(DictRolloutBuffer):
    """stable-baselines3's rollout buffer with the mixed reward: T steps of each of E cars.

    `annotate` must be called before each `add`, that is from a callback's `on_step`. Rewards are
    mixed in one batch when the rollout is complete, before returns and advantages are computed.

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
        self._outcomes: Sequence[StepOutcome] = ()
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

    def annotate(self, outcomes: Sequence[StepOutcome]) -> None:
        """Say what the next `add` is about, car by car."""
        self._outcomes = outcomes

    def add(  # type: ignore[override]  # as in stable-baselines3's own dictionary buffer
        self,
        obs: dict[str, NDArray[Any]],
        action: NDArray[Any],
        reward: NDArray[Any],
        episode_start: NDArray[Any],
        value: torch.Tensor,
        log_prob: torch.Tensor,
    ) -> None:
        """Store a step of every car.

        Raises:
            RuntimeError: If the step was not annotated.
        """
        if len(self._outcomes) != self.n_envs:
            raise RuntimeError("`annotate` must be called before each `add`.")
        action = np.array(action, np.float32).reshape(self.n_envs, 2)
        log_prob = log_prob.clone()
        place = self.pos
        self.drawn_actions[place] = np.clip(action, -1.0, 1.0)
        for car, outcome in enumerate(self._outcomes):
            if outcome.stored_action is not None:
                action[car], log_prob[car] = outcome.stored_action
            # What stable-baselines3 added at a time limit: gamma V(last observation), in critic
            # units.
            if outcome.end is End.TIME_LIMIT:
                self.bootstraps[place, car] = float(reward[car]) - np.float32(outcome.env_reward)
            self.env_rewards[place, car] = outcome.env_reward
            self.executed_actions[place, car] = outcome.executed_action
            self.ends[place, car] = outcome.end
            self.modes[place, car] = outcome.mode
        self._outcomes = ()
        super().add(obs, action, reward, episode_start, value, log_prob)

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


def flat(values: NDArray[Any]) -> NDArray[Any]:
    """(T, E, ...) as (T E, ...)."""
    return values.reshape(-1, *values.shape[2:])
