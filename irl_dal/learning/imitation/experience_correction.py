"""Safety-aware experience correction (SAEC): what is learnt from steps on which the planner acted.

| form | replay buffer D_s | PPO buffer |
|---|---|---|
| `label` (default) | state, expert's label, marker | the policy's own draw and log-probability |
| `paper` (Eq. 28) | the same | a_expert, its log-probability under the policy |
| `off` | such steps are left out | the policy's own draw |

Eq. 28 as printed tells PPO that the policy drew an action which it did not draw, with a reward that
another action earned: a biased surrogate. In the default form planner and shield are part of the
environment, and the correction reaches the policy through behaviour cloning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from irl_dal.learning.collection.step_record import DrivenStep
from irl_dal.learning.reinforcement.policy import DrivingPolicy
from irl_dal.learning.reinforcement.rollout_buffer import Correction

__all__ = ["CorrectionForm", "ExperienceCorrection"]

CorrectionForm = Literal["label", "paper", "off"]


@dataclass(slots=True)
class ExperienceCorrection:
    """Decides what is stored of an intervened step.

    Attributes:
        form: `label`, `paper` or `off`.
        marks: Transitions that went into the replay buffer with the marker so far.

    Raises:
        ValueError: If `form` is unknown.
    """

    form: CorrectionForm = "label"
    marks: int = 0

    def __post_init__(self) -> None:
        if self.form not in get_args(CorrectionForm):
            raise ValueError(
                f"`saec` must be one of {get_args(CorrectionForm)}. Got {self.form!r}."
            )

    def keeps(self, intervened: bool) -> bool:
        """Whether the replay buffer gets the step; counts the marks."""
        if intervened and self.form != "off":
            self.marks += 1
        return not intervened or self.form != "off"

    def replaces(self, intervened: bool) -> bool:
        """Whether the PPO buffer gets the expert's action in place of the policy's."""
        return intervened and self.form == "paper"

    def of(self, step: DrivenStep, policy: DrivingPolicy) -> Correction | None:
        """What the PPO buffer gets of a step in place of the policy's own draw, if anything."""
        if not self.replaces(step.transition.intervened):
            return None
        seen, _ = policy.obs_to_tensor(dict(step.seen))
        assert isinstance(seen, dict)
        return self.expert_draw(policy, seen, step.transition.label)

    @staticmethod
    @torch.no_grad()
    def expert_draw(
        policy: DrivingPolicy, observation: dict[str, Tensor], label: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float]:
        """The expert's action as the printed form stores it.

        Args:
            policy: Under which the log-probability is taken.
            observation: Of the step, batched (1, ...).
            label: a_expert (2,), normalised.

        Returns:
            The action (2,) and its log-probability.
        """
        distribution = policy.get_distribution(observation)
        actions = torch.from_numpy(label.reshape(1, 2)).to(policy.device)
        return label, float(distribution.log_prob(actions)[0])
