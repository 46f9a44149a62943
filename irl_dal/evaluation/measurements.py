"""Everything that one evaluation logged, ready to be turned into numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.plan_log import PlanLog

__all__ = ["ExpertPath", "HeldOutActions", "Measurements", "PathPair", "ReferenceReturns"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class HeldOutActions:
    """The agent's and the expert's answers in states of expert episodes that training never saw.

    Attributes:
        seed: Episode that each state comes from (M,).
        mode: Expert mode (M,).
        agent_action: (M, 2), normalised.
        expert_action: (M, 2), normalised.
    """

    seed: NDArray[np.int64]
    mode: NDArray[np.int64]
    agent_action: Array
    expert_action: Array


@dataclass(frozen=True, slots=True)
class ExpertPath:
    """Where the expert drove on a seed, all that paths are compared with.

    Attributes:
        seed: Of the episode.
        pose: True x, y, yaw before the first and after each step (T+1, 3) [m, m, rad].
    """

    seed: int
    pose: Array

    @property
    def steps(self) -> int:
        """Number of control steps T."""
        return len(self.pose) - 1


@dataclass(frozen=True, slots=True)
class PathPair:
    """Two drives from one and the same state.

    Attributes:
        seed: Expert episode that the state belongs to.
        step: Control step of the state in that episode.
        agent: Positions of the agent after each of K steps (K, 2) [m].
        expert: Positions of the expert after the same steps (K, 2) [m].
    """

    seed: int
    step: int
    agent: Array
    expert: Array


@dataclass(frozen=True, slots=True)
class ReferenceReturns:
    """What expert and random actions earn on the evaluated seeds.

    Attributes:
        expert: Sum of the environment reward of each episode (N,).
        random: The same for uniformly drawn actions (N,).
    """

    expert: Array
    random: Array


@dataclass(frozen=True, slots=True)
class Measurements:
    """The logs of one evaluation.

    Attributes:
        episodes: The agent's N episodes.
        references: Returns on the same seeds in the same order; None where they were not driven.
        held_out: Answers on held-out expert states; None where they were not asked for.
        pairs: Stretches driven from states of held-out expert episodes.
        state_plans: Plans made in logged states and not driven, one log per episode.
    """

    episodes: Sequence[Episode]
    references: ReferenceReturns | None = None
    held_out: HeldOutActions | None = None
    pairs: Sequence[PathPair] = ()
    state_plans: Sequence[PlanLog] = ()
