"""Stores, counts and averages the steps of the cars."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict
from typing import Any

import numpy as np

from expert.replay import ReplayBuffer
from irl_dal.learning.collection.step_record import Counts, EpisodeEnd, StepRecord
from irl_dal.learning.imitation.experience_correction import ExperienceCorrection

__all__ = ["Recorder"]

RECENT = 20
"""Episodes behind a running mean."""


class Recorder:
    """Takes the steps of all cars in the order in which they are learnt from.

    Args:
        replay: D_s.
        correction: Says whether intervened steps are stored.
        n_envs: Cars.

    Attributes:
        counts: What happened so far.
        upcoming: For each car, the number of the episode after its newest one.
    """

    def __init__(self, replay: ReplayBuffer, correction: ExperienceCorrection, n_envs: int) -> None:
        self.counts = Counts()
        self.upcoming = list(range(n_envs))
        self._replay = replay
        self._correction = correction
        self._returns: deque[float] = deque(maxlen=RECENT)
        self._successes: deque[float] = deque(maxlen=RECENT)

    @property
    def episode_return(self) -> float:
        """Mean undiscounted environment reward of the newest episodes; NaN before the first."""
        return float(np.mean(self._returns)) if self._returns else float("nan")

    @property
    def success_rate(self) -> float:
        """Share of successes in the newest episodes; NaN before the first."""
        return float(np.mean(self._successes)) if self._successes else float("nan")

    def take(self, record: StepRecord) -> None:
        """Store a step where the experience correction says so, and count it."""
        transition = record.transition
        if self._correction.keeps(transition.intervened):
            self._replay.add(transition)
        self.counts += record.counts
        n_envs = len(self.upcoming)
        self.upcoming[transition.episode % n_envs] = transition.episode + n_envs
        if record.end is not EpisodeEnd.GOES_ON:
            self._returns.append(record.episode_return)
            self._successes.append(float(record.end is EpisodeEnd.SUCCESS))

    def state_dict(self) -> dict[str, Any]:
        """Counts and where the episodes are; those in progress are not kept."""
        return {
            "counts": asdict(self.counts),
            "upcoming": list(self.upcoming),
            "returns": list(self._returns),
            "successes": list(self._successes),
            "marks": self._correction.marks,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over the state of `state_dict`; each car must begin its upcoming episode."""
        self.counts = Counts(**state["counts"])
        self.upcoming = list(state["upcoming"])
        self._returns.extend(state["returns"])
        self._successes.extend(state["successes"])
        self._correction.marks = state["marks"]
