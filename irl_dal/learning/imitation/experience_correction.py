"""Safety-aware experience correction (SAEC): what is learnt from steps on which the planner acted.

| form | replay buffer D_s | PPO buffer |
|---|---|---|
| `label` (default) | state, expert's label, marker | the policy's own sample and log-probability |
| `paper` (Eq. 28) | the same | a_expert, its log-probability under the policy |
| `off` | such steps are left out | the policy's own sample |

Eq. 28 as printed tells PPO that the policy sampled an action which it did not, with a reward that
another action earned: a biased surrogate. In the default form planner and shield are part of the
environment, and the correction reaches the policy through behaviour cloning.
"""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from irl_dal.learning.collection.recorder import StepRecord
from irl_dal.learning.reinforcement.policy import DrivingPolicy

CorrectionForm = Literal["label", "paper", "off"]


@torch.no_grad()
def correct_as_printed(
    policy: DrivingPolicy,
    records: Sequence[StepRecord],
    actions: NDArray[np.float32],
    log_probs: Tensor,
) -> None:
    """Put the expert's action in place of the policy's sample of every intervened step (`paper`).

    Args:
        policy: Under which the log-probability is taken.
        records: A step of each of the E cars.
        actions: The policy's samples (E, 2), normalised; changed in place.
        log_probs: Their log-probabilities (E,); changed in place.
    """
    for car, record in enumerate(records):
        driven = record.transition
        if driven.intervened:
            known: dict[str, NDArray[Any]] = {
                "image": driven.image,
                "lidar": driven.lidar,
                "speed": driven.speed,
                "context": driven.context,
            }
            seen, _ = policy.obs_to_tensor(known)
            actions[car] = driven.label
            label = torch.from_numpy(actions[car : car + 1])
            log_probs[car] = policy.get_distribution(seen).log_prob(label)[0]
