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
which neither pays nor costs. Time limits are bootstrapped with the critic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from irl_dal.learning.collection.step_record import End

__all__ = ["HybridReward", "HybridRewardConfig"]

Array = NDArray[np.float32]
Judge = Callable[[dict[str, NDArray[Any]], Array], Array | None]
ImitationForm = Literal["centred", "printed"]


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
