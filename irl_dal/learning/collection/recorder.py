"""What learning reads of the cars' steps: one step's record, and what is stored and counted."""

from collections import deque
from dataclasses import asdict, dataclass, fields
from enum import IntEnum
from typing import Any, Self

import numpy as np

from expert.replay import ReplayBuffer, Transition

RECENT = 20  # episodes behind a running mean


class EpisodeEnd(IntEnum):
    """How a step left its episode."""

    GOES_ON = 0
    SUCCESS = 1
    FAILURE = 2
    TIME_LIMIT = 3


@dataclass(frozen=True, slots=True)
class Counts:
    """What happened in a step, in several or in a whole training; numbers that only grow."""

    steps: int = 0
    episodes: int = 0  # that came to an end
    successes: int = 0  # of these, goal reached without any violation
    collisions: int = 0  # of these, ended by a collision
    triggers: int = 0  # steps on which the planner was used
    plans_projected: int = 0  # that the planner's projection changed
    plan_fallbacks: int = 0
    shield_corrections: int = 0  # steps on which the shield changed the command
    command_violations: int = 0  # executed commands beyond a bound: stays 0 with the shield
    reward: float = 0.0  # sum of the environment reward
    disagreement: float = 0.0  # sum of mean abs(policy's own action - label) / 2, its own steps

    def __add__(self, other: Self) -> Self:
        return type(self)(*(getattr(self, e.name) + getattr(other, e.name) for e in fields(self)))

    def __sub__(self, other: Self) -> Self:
        return type(self)(*(getattr(self, e.name) - getattr(other, e.name) for e in fields(self)))


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One step, as its car records it."""

    transition: Transition  # what the replay buffer may keep
    end: EpisodeEnd
    counts: Counts  # what the step adds to the run's counts
    episode_return: float  # undiscounted environment reward of the episode so far


class Recorder:
    """Stores, counts and averages the steps of all cars in the order in which they are learnt from.

    Args:
        replay: D_s.
        n_envs: Cars.
        keep_intervened: Whether D_s gets the steps on which the planner acted.

    Attributes:
        counts: What happened so far.
        marks: Intervened steps in the replay buffer so far.
        upcoming: For each car, the number of the episode after its newest one.
    """

    def __init__(self, replay: ReplayBuffer, n_envs: int, *, keep_intervened: bool = True) -> None:
        self.counts = Counts()
        self.marks = 0
        self.upcoming = list(range(n_envs))
        self._replay = replay
        self._keep_intervened = keep_intervened
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)

    @property
    def recent(self) -> tuple[float, float]:
        """Mean undiscounted return and share of successes of the newest episodes; NaN before."""
        means = np.mean(self._recent, axis=0) if self._recent else (np.nan, np.nan)
        return float(means[0]), float(means[1])

    def take(self, record: StepRecord) -> None:
        """Count a step, and store it unless it is intervened and such steps are left out."""
        transition, n_envs = record.transition, len(self.upcoming)
        if self._keep_intervened or not transition.intervened:
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
