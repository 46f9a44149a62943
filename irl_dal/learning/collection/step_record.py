"""One step of one of the cars, with everything that learning reads of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

from numpy.typing import NDArray

from expert.replay import Transition

__all__ = ["Counts", "EpisodeEnd", "StepRecord"]


class EpisodeEnd(IntEnum):
    """How a step left its episode."""

    GOES_ON = 0
    SUCCESS = 1
    FAILURE = 2
    TIME_LIMIT = 3

    @classmethod
    def of(cls, terminated: bool, truncated: bool, *, success: bool) -> EpisodeEnd:
        """From what the environment returns with a step."""
        if terminated:
            return cls.SUCCESS if success else cls.FAILURE
        return cls.TIME_LIMIT if truncated else cls.GOES_ON


@dataclass(frozen=True, slots=True)
class Counts:
    """What happened in a step, in several or in a whole training; numbers that only grow.

    Attributes:
        steps: Environment steps.
        episodes: Episodes that came to an end.
        successes: Of these, goal reached without any violation.
        collisions: Of these, ended by a collision.
        triggers: Steps on which the planner was used.
        plans_projected: Plans that the planner's projection changed.
        plan_fallbacks: Plans that were fallbacks.
        shield_corrections: Steps on which the shield changed the command.
        command_violations: Steps whose executed command broke a bound: must stay 0 with the shield.
        policy_violations: Steps on which the policy's own command would have broken a bound.
        reward: Sum of the environment reward.
        disagreement: Sum of mean abs(policy's own action - label) / 2 over the policy's steps.
    """

    steps: int = 0
    episodes: int = 0
    successes: int = 0
    collisions: int = 0
    triggers: int = 0
    plans_projected: int = 0
    plan_fallbacks: int = 0
    shield_corrections: int = 0
    command_violations: int = 0
    policy_violations: int = 0
    reward: float = 0.0
    disagreement: float = 0.0

    def __add__(self, other: Counts) -> Counts:
        return Counts(*(getattr(self, e.name) + getattr(other, e.name) for e in fields(self)))

    def __sub__(self, earlier: Counts) -> Counts:
        return Counts(*(getattr(self, e.name) - getattr(earlier, e.name) for e in fields(self)))


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One step, as its car records it.

    Attributes:
        transition: What the replay buffer may keep.
        end: Whether and how the episode ended.
        counts: What the step adds to the run's counts.
        episode_return: Undiscounted environment reward of the episode so far.
    """

    transition: Transition
    end: EpisodeEnd
    counts: Counts
    episode_return: float

    @property
    def seen(self) -> Mapping[str, NDArray[Any]]:
        """The observation acted upon."""
        known = self.transition
        return {"image": known.image, "lidar": known.lidar, "speed": known.speed}
