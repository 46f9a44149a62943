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

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from irl_dal.checks import check_choices
from irl_dal.learning.collection.recorder import EpisodeEnd

Array = NDArray[np.float32]
ImitationForm = Literal["centred", "printed"]

# Logit that is worth a `centred` reward of 1: D = 0.982, about as sure as the discriminator gets
# beside the noise on its actions.
LOGIT_SCALE = 4.0
EPSILON = 1e-8  # keeps the logarithm of the printed form finite (the paper gives no number)
R_MIN, R_MAX = 0.0, 5.0  # of the printed form ("a predefined range"; the paper gives no numbers)


@dataclass(frozen=True, slots=True)
class HybridRewardConfig:
    """Weights, a convex combination, and forms."""

    w_env: float = 0.7  # weight of the environment's reward (Table II)
    w_irl: float = 0.3  # weight of the discriminator's reward (Table II)
    form: ImitationForm = "centred"  # `centred` or `printed`
    absorbing: bool = True  # let r_irl go on after the end of an episode
    # Multiply by 1 - gamma, so that returns are of the size of one reward and the value loss does
    # not drown the policy's gradient in the shared features.
    unit_returns: bool = True

    def __post_init__(self) -> None:
        if min(self.w_env, self.w_irl) < 0.0 or abs(self.w_env + self.w_irl - 1.0) > 1e-9:
            raise ValueError(
                f"`w_env` and `w_irl` must be >= 0 and add to 1. Got {self.w_env}, {self.w_irl}."
            )
        check_choices(self)


@dataclass(frozen=True, slots=True)
class HybridReward:
    """Mixes the two rewards."""

    config: HybridRewardConfig
    gamma: float  # discount factor

    @property
    def scale(self) -> float:
        """What every reward is multiplied with before the critic sees it."""
        return 1.0 - self.gamma if self.config.unit_returns else 1.0

    def imitation_reward(self, expert_logit: Array) -> Array:
        """r_irl for logits of any shape."""
        if self.config.form == "centred":
            return np.clip(expert_logit / LOGIT_SCALE, -1.0, 1.0).astype(np.float32)
        other = 1.0 / (1.0 + np.exp(np.clip(expert_logit, -60.0, 60.0).astype(np.float64)))
        printed = -np.log(other + EPSILON)  # Eq. gail_reward, 1 - D = other
        return np.clip(printed, R_MIN, R_MAX).astype(np.float32)

    def continuation(self, ends: NDArray[np.int8], imitation: Array) -> Array:
        """What r_irl is worth after each step: zero except where an episode ends for good."""
        if not self.config.absorbing or not imitation.size:
            return np.zeros_like(imitation)
        for_ever = self.gamma / (1.0 - self.gamma)
        failed = ends == EpisodeEnd.FAILURE
        worst = -1.0 if self.config.form == "centred" else R_MIN
        after = np.where(failed, worst, float(imitation.mean())) * for_ever
        ended = failed | (ends == EpisodeEnd.SUCCESS)
        return np.where(ended, after, 0.0).astype(np.float32)

    def mix(self, env: Array, imitation: Array, ends: NDArray[np.int8]) -> Array:
        """Eq. hybrid_reward, scaled; all arrays of one shape."""
        imitated = imitation + self.continuation(ends, imitation)
        mixed = self.config.w_env * env + self.config.w_irl * imitated
        return (self.scale * mixed).astype(np.float32)
