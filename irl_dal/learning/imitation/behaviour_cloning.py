"""Behaviour cloning: the policy's mean action follows the expert's label (Eq. bc_loss_with_l2).

| here | paper |
|---|---|
| `mean_action` | pi_theta(s_t) |
| `labels` | a_expert |
| `config.l2` | lambda_L2, on the policy's weights and not on the mask's alphas |
| `config.max_grad_norm` | G_max |

The mask (LAM) lies on the way from observation to action, so these gradients train it too.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from expert.modes import Mode
from expert.replay import ReplayBatch, ReplayBuffer
from irl_dal.learning.reinforcement.policy import (
    DrivingPolicy,
    actor_parameters,
    mean_action,
    observation_tensors,
)
from irl_dal.perception import LearnableAdaptiveMask
from irl_dal.shortcuts import reduced_precision
from shield.errors import check_positive, check_within

# Gradient steps between two looks of the plateau scheduler, each at the mean held-out loss since
# the last one: as many as an update of phase 1 has. One of phase 2 alone is too short to tell.
STEPS_PER_LOOK = 150

# By which the learning rate falls on a plateau (stable practice; Table II gives the patience only),
# and where it stops falling: new states keep coming.
FACTOR, MIN_LEARNING_RATE = 0.5, 5e-5

VALIDATION_SIZE = 512  # held-out samples behind each reported loss, drawn evenly over the modes


@dataclass(frozen=True, slots=True)
class CloningConfig:
    """Behaviour cloning (Table II unless the attribute says otherwise)."""

    learning_rate: float = 3e-4  # eta_BC of Adam
    l2: float = 1e-6  # lambda_L2
    max_grad_norm: float = 0.5  # G_max
    patience: int = 5  # looks at the held-out loss without progress before the learning rate falls
    batch_size: int = 128  # samples per gradient step (not in the paper)
    steps_imitation: int = 150  # gradient steps per update in phase 1 (not in the paper)
    steps_mixed: int = 60  # gradient steps per update in phase 2 (not in the paper)
    # Part of each batch drawn from the steps that experience correction marked, as soon as there
    # are any (not in the paper).
    corrected_share: float = 0.25

    def __post_init__(self) -> None:
        rates = {"learning_rate": self.learning_rate, "max_grad_norm": self.max_grad_norm}
        check_positive(ValueError, **rates)
        names = ("l2", "patience", "steps_imitation", "steps_mixed")
        check_within(ValueError, 0, math.inf, **{name: getattr(self, name) for name in names})
        check_within(ValueError, 1, math.inf, batch_size=self.batch_size)
        check_within(ValueError, 0.0, 1.0, corrected_share=self.corrected_share)


class BehaviourCloning:
    """Trains the actor half of a policy with its own Adam.

    Args:
        policy: Whose mean action learns.
        config: Learning rate, regularisation, sizes.
    """

    def __init__(self, policy: DrivingPolicy, config: CloningConfig) -> None:
        self.config = config
        self.policy = policy
        self._parameters = actor_parameters(policy)
        modules = policy.features_extractor.modules()
        masks = [module for module in modules if isinstance(module, LearnableAdaptiveMask)]
        alphas = {id(parameter) for mask in masks for parameter in mask.parameters()}
        self._regularised = [p for p in self._parameters if id(p) not in alphas]
        self._optimizer = torch.optim.Adam(self._parameters, lr=config.learning_rate, fused=True)
        self._scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self._optimizer, factor=FACTOR, patience=config.patience, min_lr=MIN_LEARNING_RATE
        )
        self._steps = 0
        self._seen: list[float] = []

    @property
    def learning_rate(self) -> float:
        """Where the plateau scheduler has brought it."""
        return float(self._optimizer.param_groups[0]["lr"])

    def loss(self, observation: dict[str, Tensor], labels: Tensor) -> Tensor:
        """Eq. bc_loss_with_l2: batch mean of the squared norm, plus the L2 term; a scalar."""
        with reduced_precision():
            actions = mean_action(self.policy, observation)
        error = actions.float() - labels
        norm = torch.stack([parameter.square().sum() for parameter in self._regularised]).sum()
        return error.square().sum(dim=1).mean() + self.config.l2 * norm

    def update(self, draw: Callable[[], ReplayBatch], steps: int) -> float:
        """Take steps, each on a batch of `draw`; gives the mean loss with L2, NaN for no steps."""
        self.policy.set_training_mode(True)
        losses = []
        for _ in range(steps):
            batch = draw()
            loss = self.loss(observation_tensors(batch), torch.from_numpy(batch.labels))
            self._optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self._parameters, self.config.max_grad_norm)
            self._optimizer.step()
            losses.append(loss.item())
        self._steps += steps
        # PPO shares these parameters and must not see gradients that are left over.
        self._optimizer.zero_grad()
        self.policy.set_training_mode(False)
        return float(np.mean(losses)) if losses else float("nan")

    def validate(self, replay: ReplayBuffer, rng: np.random.Generator) -> dict[Mode, float]:
        """Held-out loss of each mode, without the L2 term; empty while nothing is held out.

        Mean squared error over samples and both components, normalised units. The mean over the
        modes is the `bc_loss` of the reports.
        """
        if replay.count(held_out=True) == 0:
            return {}
        batch = replay.sample(rng, VALIDATION_SIZE, held_out=True)
        with torch.no_grad():
            actions = mean_action(self.policy, observation_tensors(batch))
        errors = (actions.numpy() - batch.labels) ** 2
        present = map(Mode, np.unique(batch.modes))
        return {mode: float(errors[batch.modes == mode].mean()) for mode in present}

    def plateau(self, loss: float) -> None:
        """Take note of a held-out loss; the scheduler looks every `STEPS_PER_LOOK` steps."""
        self._seen.append(loss)
        if self._steps >= STEPS_PER_LOOK:
            self._scheduler.step(float(np.mean(self._seen)))
            self._steps, self._seen = 0, []

    def state_dict(self) -> dict[str, Any]:
        """Optimiser and scheduler (the policy's weights are the policy's)."""
        return {
            "optimizer": self._optimizer.state_dict(),
            "scheduler": self._scheduler.state_dict(),
            "steps": self._steps,
            "seen": list(self._seen),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over the state of `state_dict`."""
        self._optimizer.load_state_dict(state["optimizer"])
        self._scheduler.load_state_dict(state["scheduler"])
        self._steps, self._seen = state["steps"], list(state["seen"])
