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
        marks: Intervened steps in the replay buffer so far.
        upcoming: For each car, the number of the episode after its newest one.
    """

    def __init__(self, replay: ReplayBuffer, correction: ExperienceCorrection, n_envs: int) -> None:
        self.counts = Counts()
        self.marks = 0
        self.upcoming = list(range(n_envs))
        self._replay = replay
        self._correction = correction
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)

    @property
    def recent(self) -> tuple[float, float]:
        """Mean undiscounted return and share of successes of the newest episodes; NaN before."""
        means = np.mean(self._recent, axis=0) if self._recent else (np.nan, np.nan)
        return float(means[0]), float(means[1])

    def take(self, record: StepRecord) -> None:
        """Store a step where the experience correction says so, and count it."""
        transition, n_envs = record.transition, len(self.upcoming)
        if self._correction.keeps(transition.intervened):
            self._replay.add(transition)
            self.marks += int(transition.intervened)
        self.counts += record.counts
        self.upcoming[transition.episode % n_envs] = transition.episode + n_envs
        if record.end is not EpisodeEnd.GOES_ON:
            success = float(record.end is EpisodeEnd.SUCCESS)
            self._recent.append((record.episode_return, success))

    def state_dict(self) -> dict[str, Any]:
        """Counts and where the episodes are, without those in progress."""
        return {
            "counts": asdict(self.counts),
            "marks": self.marks,
            "upcoming": list(self.upcoming),
            "recent": list(self._recent),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over the state of `state_dict`; each car must begin its upcoming episode."""
        self.counts, self.marks = Counts(**state["counts"]), state["marks"]
        self.upcoming = list(state["upcoming"])
        self._recent.extend(state["recent"])
