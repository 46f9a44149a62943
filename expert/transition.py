"""One control step as the experience buffer keeps it, and a batch of them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from expert.modes import Mode

__all__ = ["ReplayBatch", "Transition"]


@dataclass(frozen=True, slots=True)
class Transition:
    """One control step, as it is stored.

    Attributes:
        image: Camera frame (64, 64, 3), uint8.
        lidar: Ranges (180,) [m].
        speed: Measured speed (1,) [m/s].
        context: The planner's conditioning vector (64,), normalised.
        label: What the expert would do in this state, its set-point (2,), normalised.
        command: What was executed (2,), normalised.
        mode: FSM state of the expert.
        episode: Number of the episode, never used twice.
        step: Step within the episode.
        reward: Environment reward of the step.
        terminated: The step ended the episode (not by a time limit).
        intervened: The planner acted on this step: the marker of experience correction.
        expert_drove: `command` is the expert's.
    """

    image: NDArray[np.uint8]
    lidar: NDArray[np.float32]
    speed: NDArray[np.float32]
    context: NDArray[np.float32]
    label: NDArray[np.float32]
    command: NDArray[np.float32]
    mode: Mode
    episode: int
    step: int
    reward: float
    terminated: bool
    intervened: bool
    expert_drove: bool


@dataclass(frozen=True, slots=True)
class ReplayBatch:
    """B stored transitions (copies).

    Attributes:
        images: (B, 64, 64, 3) uint8.
        lidar: (B, 180) [m].
        speeds: (B, 1) [m/s].
        labels: Expert set-points (B, 2), normalised.
        commands: Executed commands (B, 2), normalised.
        modes: (B,).
        intervened: (B,).
    """

    images: NDArray[np.uint8]
    lidar: NDArray[np.float32]
    speeds: NDArray[np.float32]
    labels: NDArray[np.float32]
    commands: NDArray[np.float32]
    modes: NDArray[np.int8]
    intervened: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.labels)

    @classmethod
    def join(cls, first: ReplayBatch, second: ReplayBatch) -> ReplayBatch:
        """Both batches, one after the other."""
        names = (entry.name for entry in fields(cls))
        pairs = {name: (getattr(first, name), getattr(second, name)) for name in names}
        return cls(**{name: np.concatenate(pair) for name, pair in pairs.items()})
