"""The callback through which stable-baselines3's PPO takes part in phase 2."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import torch
from stable_baselines3.common.callbacks import BaseCallback

from irl_dal.learning.driver import DRIVEN, DrivenStep
from irl_dal.learning.hybrid_reward import End, HybridRolloutBuffer

__all__ = ["MixedPhase"]


class MixedPhase(BaseCallback):
    """Hands the cars' steps on, records the rollout's rewards and measures what PPO's update takes.

    Args:
        on_step: Is called with the observations acted upon, batched, and the step that each car
            has driven, before PPO stores them.
    """

    def __init__(
        self, on_step: Callable[[dict[str, torch.Tensor], Sequence[DrivenStep]], None]
    ) -> None:
        super().__init__()
        self._handle = on_step
        self._collected = time.monotonic()

    def since_rollout(self) -> float:
        """Seconds since the rollout was complete."""
        return time.monotonic() - self._collected

    def _on_step(self) -> bool:
        driven = [info[DRIVEN] for info in self.locals["infos"]]
        self._handle(self.locals["obs_tensor"], driven)
        return True

    def _on_rollout_end(self) -> None:
        self._collected = time.monotonic()
        buffer = self.model.rollout_buffer  # type: ignore[attr-defined]
        assert isinstance(buffer, HybridRolloutBuffer)
        self.logger.record("reward/env", float(buffer.env_rewards.mean()))
        self.logger.record("reward/imitation", float(buffer.imitation_rewards.mean()))
        self.logger.record("reward/failures", int((buffer.ends == End.FAILURE).sum()))
