"""The GAIL discriminator D_psi(s, a) (Eq. discriminator_loss).

Sign convention: D -> 1 means *expert*. The network returns `expert_logit` = log D - log(1 - D); a
positive logit says "the expert would do this".

| here | paper |
|---|---|
| `features` | s_t, from a frozen copy of the policy's perception (SyncFeatures renews it) |
| `actions` | a_t, as executed: the expert's and the agent's commands went through the same shield |
| `bce` | L_Disc |
"""

import copy
import math
from dataclasses import dataclass
from typing import Any

import torch
from stable_baselines3.common.preprocessing import preprocess_obs
from torch import Tensor, nn
from torch.nn.functional import softplus

from irl_dal.learning.reinforcement.policy import DrivingPolicy
from shield.errors import check_positive, check_within

KEPT_OUT = 5  # one pair in so many is kept out of an update, to report an honest accuracy
HIDDEN = 128  # units in each of the two hidden layers (not in the paper): a quarter of the features
BATCH_SIZE = 256  # expert samples, and as many of the agent's, per gradient step (not in the paper)
WEIGHT_DECAY = 1e-3  # of Adam (not in the paper): against overfitting to the few pairs of an update
MAX_GRAD_NORM = 0.5  # G_max (Table II)

# Standard deviation of the noise on both sides' actions in training, normalised units: without it
# the agent's exploration noise alone gives it away, and the reward is -1 whatever it does.
ACTION_NOISE = 0.1

Seen = tuple[dict[str, Tensor], Tensor]  # observations and executed actions
_Pairs = tuple[Tensor, Tensor]  # features and actions


@dataclass(frozen=True, slots=True)
class DiscriminatorConfig:
    """The discriminator (nothing of it is in the paper but its loss and its interval)."""

    learning_rate: float = 3e-4  # of Adam
    steps: int = 100  # gradient steps per update
    # Expert samples, and at most as many of the agent's, that are encoded per update.
    samples: int = 2048

    def __post_init__(self) -> None:
        check_within(ValueError, 1, math.inf, steps=self.steps, samples=self.samples)
        check_positive(ValueError, learning_rate=self.learning_rate)


class Discriminator:
    """A small MLP on frozen features and an action, with the optimiser that trains it.

    It copies the policy's perception; `generator` draws first weights, batches and action noise.
    """

    def __init__(
        self, policy: DrivingPolicy, config: DiscriminatorConfig, generator: torch.Generator
    ) -> None:
        self.config = config
        self.updates = 0
        self._generator = generator
        self._space = policy.observation_space
        self._encoder = copy.deepcopy(policy.features_extractor).requires_grad_(False).eval()
        with torch.random.fork_rng():
            torch.manual_seed(int(torch.randint(2**62, (), generator=generator)))
            # LayerNorm because the features' scale drifts between syncs.
            layers = nn.Sequential(
                nn.Linear(policy.features_dim + 2, HIDDEN),
                nn.Tanh(),
                nn.Linear(HIDDEN, HIDDEN),
                nn.Tanh(),
                nn.Linear(HIDDEN, 1),
            )
            norm = nn.LayerNorm(policy.features_dim)
            self._head = nn.ModuleDict({"norm": norm, "layers": layers})
        self._optimizer = torch.optim.Adam(
            self._head.parameters(), lr=config.learning_rate, weight_decay=WEIGHT_DECAY
        )

    def sync_features(self, policy: DrivingPolicy) -> None:
        """SyncFeatures: copy the policy's perception into the frozen encoder."""
        self._encoder.load_state_dict(policy.features_extractor.state_dict())

    @torch.no_grad()
    def features(self, observation: dict[str, Tensor], batch_size: int = 512) -> Tensor:
        """Frozen features (B, 512) of observations as the policy takes them."""
        parts = []
        for start in range(0, len(observation["speed"]), batch_size):
            rows = {k: v[start : start + batch_size] for k, v in observation.items()}
            prepared = preprocess_obs(rows, self._space, normalize_images=True)
            parts.append(self._encoder(prepared))
        return torch.cat(parts)

    def expert_logit(self, features: Tensor, actions: Tensor) -> Tensor:
        """Logit log D - log(1 - D) (B,) of features (B, 512) and executed actions (B, 2)."""
        known = torch.cat([self._head["norm"](features), actions.to(features)], dim=1)
        return self._head["layers"](known).squeeze(1)

    @torch.no_grad()
    def judge(self, observation: dict[str, Tensor], actions: Tensor) -> Tensor:
        """`expert_logit` of observations, without gradients."""
        return self.expert_logit(self.features(observation), actions)

    def update(self, expert: Seen, agent: Seen) -> dict[str, float]:
        """Train on both sides; gives what the log says of it, of pairs that were kept out.

        `loss` is the mean binary cross-entropy in training, both sides added; `accuracy` the share
        of pairs that are told apart (0.5 is a coin); the logits are means.
        """
        ours, ours_kept = self._split(*agent)
        theirs, theirs_kept = self._split(*expert)
        losses = []
        for _ in range(self.config.steps):
            loss = discriminator_loss(
                self.expert_logit(*self._batch(*theirs)), self.expert_logit(*self._batch(*ours))
            )
            self._optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self._head.parameters(), MAX_GRAD_NORM)
            self._optimizer.step()
            losses.append(loss.item())
        self.updates += 1
        with torch.no_grad():
            expert_logit = self.expert_logit(*theirs_kept)
            agent_logit = self.expert_logit(*ours_kept)
        right = ((expert_logit > 0).float().mean() + (agent_logit <= 0).float().mean()) / 2
        return {
            "loss": sum(losses) / len(losses),
            "accuracy": right.item(),
            "expert_logit": expert_logit.mean().item(),
            "agent_logit": agent_logit.mean().item(),
        }

    def state_dict(self) -> dict[str, Any]:
        """Head, encoder, optimiser, random state and count of updates."""
        return {
            "head": self._head.state_dict(),
            "encoder": self._encoder.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "generator": self._generator.get_state(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over the state of `state_dict`."""
        self._head.load_state_dict(state["head"])
        self._encoder.load_state_dict(state["encoder"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._generator.set_state(state["generator"])
        self.updates = state["updates"]

    def _split(self, observation: dict[str, Tensor], actions: Tensor) -> tuple[_Pairs, _Pairs]:
        """Encoded pairs for training and, one in `KEPT_OUT`, for the report."""
        features = self.features(observation)
        kept = torch.arange(len(actions)) % KEPT_OUT == 0
        if len(actions) < KEPT_OUT:
            return (features, actions), (features, actions)
        return (features[~kept], actions[~kept]), (features[kept], actions[kept])

    def _batch(self, features: Tensor, actions: Tensor) -> _Pairs:
        rows = torch.randint(len(features), (BATCH_SIZE,), generator=self._generator)
        noise = torch.randn((BATCH_SIZE, 2), generator=self._generator)
        return features[rows], actions[rows] + ACTION_NOISE * noise


def discriminator_loss(expert_logit: Tensor, agent_logit: Tensor) -> Tensor:
    """Eq. discriminator_loss: -E_expert[log D] - E_agent[log(1 - D)], from logits; a scalar."""
    return softplus(-expert_logit).mean() + softplus(agent_logit).mean()
