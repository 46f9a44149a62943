"""One control step as the experience buffer keeps it, and a batch of them."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from expert.modes import Mode


@dataclass(frozen=True, slots=True)
class Transition:
    """One control step, as it is stored."""

    image: NDArray[np.uint8]  # Camera frame (64, 64, 3), uint8
    lidar: NDArray[np.float32]  # Ranges (180,) [m]
    speed: NDArray[np.float32]  # Measured speed (1,) [m/s]
    context: NDArray[np.float32]  # The planner's conditioning vector (64,), normalised
    # What the expert would do in this state, its set-point (2,), normalised
    label: NDArray[np.float32]
    command: NDArray[np.float32]  # What was executed (2,), normalised
    mode: Mode  # FSM state of the expert
    episode: int  # Number of the episode, never used twice
    step: int  # Step within the episode
    reward: float  # Environment reward of the step
    terminated: bool  # The step ended the episode (not by a time limit)
    intervened: bool  # The planner acted on this step: the marker of experience correction
    expert_drove: bool  # `command` is the expert's


@dataclass(frozen=True, slots=True)
class ReplayBatch:
    """B stored transitions (copies)."""

    images: NDArray[np.uint8]  # (B, 64, 64, 3) uint8
    lidar: NDArray[np.float32]  # (B, 180) [m]
    speeds: NDArray[np.float32]  # (B, 1) [m/s]
    labels: NDArray[np.float32]  # Expert set-points (B, 2), normalised
    commands: NDArray[np.float32]  # Executed commands (B, 2), normalised
    modes: NDArray[np.int8]  # (B,)
    intervened: NDArray[np.bool_]  # (B,)

    def __len__(self) -> int:
        return len(self.labels)

    @classmethod
    def join(cls, first: ReplayBatch, second: ReplayBatch) -> ReplayBatch:
        """Both batches, one after the other."""
        names = (entry.name for entry in fields(cls))
        pairs = {name: (getattr(first, name), getattr(second, name)) for name in names}
        return cls(**{name: np.concatenate(pair) for name, pair in pairs.items()})
