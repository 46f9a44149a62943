"""One step of one of the cars, with all that learning has to know of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from expert.replay import Transition
from irl_dal.learning.collection.counts import Counts

__all__ = ["Draw", "DrivenStep", "End"]


class End(IntEnum):
    """How a step left its episode."""

    GOES_ON = 0
    SUCCESS = 1
    FAILURE = 2
    TIME_LIMIT = 3

    @classmethod
    def of(cls, terminated: bool, truncated: bool, *, success: bool) -> End:
        """From what the environment says of a step."""
        if terminated:
            return cls.SUCCESS if success else cls.FAILURE
        return cls.TIME_LIMIT if truncated else cls.GOES_ON


@dataclass(frozen=True, slots=True)
class Draw:
    """What the policy drew in a state.

    Attributes:
        action: Its action (2,), normalised, not clipped.
        value: Of the state.
        log_prob: Of the action.
        last_value: Value of the state that the step led to; only where the time is up there.
    """

    action: NDArray[np.float32]
    value: float
    log_prob: float
    last_value: float = 0.0


@dataclass(frozen=True, slots=True)
class DrivenStep:
    """One step, as the driver tells it.

    Attributes:
        transition: What the replay buffer may keep.
        end: Whether and how the episode ended.
        counts: What the step adds to the run's counts.
        episode_return: Undiscounted environment reward of the episode so far.
        draw: Of the policy; None where the expert drove.
    """

    transition: Transition
    end: End
    counts: Counts
    episode_return: float
    draw: Draw | None = None

    @property
    def seen(self) -> Mapping[str, NDArray[Any]]:
        """The observation acted upon."""
        known = self.transition
        return {"image": known.image, "lidar": known.lidar, "speed": known.speed}
