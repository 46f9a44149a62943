"""Training of the planner's denoiser on what the expert executed (paper, Phase 1; Ho et al., 2020).

The loss is the planner's own (`DiffusionPlanner.loss`), since it knows what its network predicts.
The network that plans carries the exponential moving average of the weights; the weights that the
optimiser moves are kept here.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from expert.replay import ReplayBuffer
from irl_dal.learning.precision import reduced_precision
from irl_dal.planner import DiffusionPlanner

__all__ = ["DiffusionTraining", "DiffusionTrainingConfig"]


@dataclass(frozen=True, slots=True)
class DiffusionTrainingConfig:
    """Training of the planner (not in the paper unless stated).

    Attributes:
        learning_rate: Of Adam.
        max_grad_norm: Larger than Table II's G_max, which is the policy's: the denoiser's
            gradients are not mixed with a policy's.
        patience: Updates without progress before the learning rate falls (Table II).
        factor: By which it falls.
        min_learning_rate: Where it stops falling.
        batch_size: Chunks per gradient step.
        steps_imitation: Gradient steps per update in phase 1.
        steps_mixed: Gradient steps per update in phase 2.
        average_decay: Share of the moving average that a gradient step leaves in place; 0 for the
            newest weights.
        validation_size: Held-out chunks behind each reported loss.
        bfloat16: Multiply in bfloat16 in gradient steps where the processor can: a third faster,
            with the same held-out loss.
    """

    learning_rate: float = 1e-3
    max_grad_norm: float = 1.0
    patience: int = 5
    factor: float = 0.5
    min_learning_rate: float = 1e-4
    batch_size: int = 256
    steps_imitation: int = 40
    steps_mixed: int = 10
    average_decay: float = 0.99
    validation_size: int = 512
    bfloat16: bool = True

    def __post_init__(self) -> None:
        for name in ("learning_rate", "max_grad_norm"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"`{name}` must be positive. Got {getattr(self, name)}.")
        for name in ("steps_imitation", "steps_mixed", "patience", "min_learning_rate"):
            if getattr(self, name) < 0:
                raise ValueError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
        for name in ("batch_size", "validation_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        if not 0.0 < self.factor < 1.0:
            raise ValueError(f"`factor` must be in (0, 1). Got {self.factor}.")
        if not 0.0 <= self.average_decay < 1.0:
            raise ValueError(f"`average_decay` must be in [0, 1). Got {self.average_decay}.")


class DiffusionTraining:
    """Trains a planner's network in place.

    Args:
        planner: Whose network learns.
        config: Rates and sizes.
        rng: Source of the batches; noise and diffusion steps come from the planner's generator.
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
        self._optimizer = torch.optim.Adam(
            self._network.parameters(), lr=config.learning_rate, fused=True
        )
        self._scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self._optimizer,
            factor=config.factor,
            patience=config.patience,
            min_lr=config.min_learning_rate,
        )

    @property
    def learning_rate(self) -> float:
        """Where the plateau scheduler has brought it."""
        return float(self._optimizer.param_groups[0]["lr"])

    def update(self, replay: ReplayBuffer, steps: int, *, balanced: bool = True) -> float:
        """Take gradient steps on the expert's chunks.

        Args:
            replay: Where the chunks come from; must have some.
            steps: How many.
            balanced: Evenly over the modes of the chunks' first steps.

        Returns:
            Mean training loss; NaN for no steps.
        """
        average = _clone(self._network)
        self._network.load_state_dict(self._trained)
        self._network.train()
        losses = []
        for _ in range(steps):
            chunks = replay.chunks(self._rng, self.config.batch_size, balanced=balanced)
            with reduced_precision(self._device, wanted=self.config.bfloat16):
                loss = self.planner.loss(*_tensors(chunks, self._device))
            self._optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self._network.parameters(), self.config.max_grad_norm)
            self._optimizer.step()
            self._follow(average)
            losses.append(loss.item())
        self._optimizer.zero_grad()
        self._trained = _clone(self._network)
        self._network.load_state_dict(average)
        self._network.eval()
        return float(np.mean(losses)) if losses else float("nan")

    def validate(self, replay: ReplayBuffer) -> float | None:
        """Loss of the averaged weights on held-out chunks, told to the scheduler; None without."""
        if replay.count(held_out=True, source="chunk") == 0:
            return None
        chunks = replay.chunks(self._rng, self.config.validation_size, held_out=True)
        with torch.no_grad():
            loss = self.planner.loss(*_tensors(chunks, self._device)).item()
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

    @property
    def _device(self) -> torch.device:
        return next(self._network.parameters()).device

    @torch.no_grad()
    def _follow(self, average: dict[str, Tensor]) -> None:
        """Move the average towards the weights, faster at first to forget the early ones."""
        self._updates += 1
        decay = min(self.config.average_decay, self._updates / (self._updates + 10.0))
        for name, value in self._network.state_dict().items():
            average[name].lerp_(value, 1.0 - decay)


def _clone(network: nn.Module) -> dict[str, Tensor]:
    return {name: value.detach().clone() for name, value in network.state_dict().items()}


def _tensors(
    chunks: tuple[NDArray[np.float32], NDArray[np.float32]], device: torch.device
) -> tuple[Tensor, Tensor]:
    contexts, actions = chunks
    return torch.from_numpy(contexts).to(device), torch.from_numpy(actions).to(device)
