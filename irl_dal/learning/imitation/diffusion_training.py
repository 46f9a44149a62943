"""Training of the planner's denoiser on what the expert executed (paper, Phase 1; Ho et al., 2020).

The loss is the planner's own (`DiffusionPlanner.loss`), since it knows what its network predicts.
The network that plans carries the exponential moving average of the weights; the weights that the
optimiser moves are kept here.
"""

import copy
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from expert.replay import ReplayBuffer
from irl_dal.planner import DiffusionPlanner
from irl_dal.shortcuts import reduced_precision
from shield.errors import check_positive, check_within

MAX_GRAD_NORM = 1.0  # Table II's G_max is the policy's: the denoiser has gradients of its own

# Updates without progress before the learning rate falls (Table II), by which it falls, and where
# it stops falling: new stretches keep coming.
PATIENCE, FACTOR, MIN_LEARNING_RATE = 5, 0.5, 1e-4

AVERAGE_DECAY = 0.99  # of the moving average per gradient step: it spans about two updates
VALIDATION_SIZE = 512  # held-out chunks behind each reported loss


@dataclass(frozen=True, slots=True)
class DiffusionTrainingConfig:
    """Training of the planner (not in the paper)."""

    learning_rate: float = 1e-3  # of Adam
    batch_size: int = 256  # chunks per gradient step
    steps_imitation: int = 40  # gradient steps per update in phase 1
    # The same in phase 2; 0 trains the planner in phase 1 only (Algorithm 1 does not say).
    steps_mixed: int = 10

    def __post_init__(self) -> None:
        check_positive(ValueError, learning_rate=self.learning_rate)
        check_within(ValueError, 1, math.inf, batch_size=self.batch_size)
        steps = {"steps_imitation": self.steps_imitation, "steps_mixed": self.steps_mixed}
        check_within(ValueError, 0, math.inf, **steps)


class DiffusionTraining:
    """Trains a planner's network in place.

    `rng` draws the batches; noise and diffusion steps come from the planner's generator.
    """

    def __init__(
        self, planner: DiffusionPlanner, config: DiffusionTrainingConfig, rng: np.random.Generator
    ) -> None:
        self.config = config
        self.planner = planner
        self._rng = rng
        self._network: nn.Module = planner.denoiser
        self._trained = copy.deepcopy(self._network.state_dict())
        self._updates = 0
        weights = self._network.parameters()
        self._optimizer = torch.optim.Adam(weights, lr=config.learning_rate, fused=True)
        self._scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self._optimizer, factor=FACTOR, patience=PATIENCE, min_lr=MIN_LEARNING_RATE
        )

    @property
    def learning_rate(self) -> float:
        """Where the plateau scheduler has brought it."""
        return float(self._optimizer.param_groups[0]["lr"])

    def update(self, replay: ReplayBuffer, steps: int, *, balanced: bool = True) -> float:
        """Take gradient steps on the expert's chunks; gives the mean loss, NaN for no steps.

        Args:
            replay: Must have chunks.
            steps: How many.
            balanced: Evenly over the modes of the chunks' first steps.
        """
        average = copy.deepcopy(self._network.state_dict())
        self._network.load_state_dict(self._trained)
        self._network.train()
        losses = []
        for _ in range(steps):
            chunks = replay.chunks(self._rng, self.config.batch_size, balanced=balanced)
            with reduced_precision():
                loss = self.planner.loss(*map(torch.from_numpy, chunks))
            self._optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self._network.parameters(), MAX_GRAD_NORM)
            self._optimizer.step()
            self._follow(average)
            losses.append(loss.item())
        self._optimizer.zero_grad()
        self._trained = copy.deepcopy(self._network.state_dict())
        self._network.load_state_dict(average)
        self._network.eval()
        return float(np.mean(losses)) if losses else float("nan")

    def validate(self, replay: ReplayBuffer) -> float | None:
        """Loss of the averaged weights on held-out chunks, told to the scheduler; None without."""
        if replay.count(held_out=True, source="chunk") == 0:
            return None
        chunks = replay.chunks(self._rng, VALIDATION_SIZE, held_out=True)
        with torch.no_grad():
            loss = self.planner.loss(*map(torch.from_numpy, chunks)).item()
        self._scheduler.step(loss)
        return loss

    def state_dict(self) -> dict[str, Any]:
        """Averaged and trained weights, optimiser, scheduler and the planner's random state."""
        return {
            "network": self._network.state_dict(),
            "trained": self._trained,
            "updates": self._updates,
            "optimizer": self._optimizer.state_dict(),
            "scheduler": self._scheduler.state_dict(),
            "generator": self.planner.generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over the state of `state_dict`."""
        self._network.load_state_dict(state["network"])
        self._trained = dict(state["trained"])
        self._updates = state["updates"]
        self._optimizer.load_state_dict(state["optimizer"])
        self._scheduler.load_state_dict(state["scheduler"])
        self.planner.generator.set_state(state["generator"])

    @torch.no_grad()
    def _follow(self, average: dict[str, Tensor]) -> None:
        """Move the average towards the weights, faster at first to forget the early ones."""
        self._updates += 1
        decay = min(AVERAGE_DECAY, self._updates / (self._updates + 10.0))
        for name, value in self._network.state_dict().items():
            average[name].lerp_(value, 1.0 - decay)
