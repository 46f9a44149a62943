"""What an evaluation is asked to do."""

from dataclasses import dataclass

FIRST_EVALUATION_SEED = 10_000
"""Evaluation seeds start here. Seeds from 0 on are for tuning; training's are the learning group's
`first_seed` and larger."""


@dataclass(frozen=True, slots=True)
class EvaluationConfig:
    """Extent of an evaluation. None of the numbers is in the paper."""

    episodes: int = 20  # that the agent drives, one seed each
    first_seed: int = FIRST_EVALUATION_SEED  # of the first one; the others follow
    held_out_episodes: int = 10
    """Expert episodes, on the same first seeds, whose states the BC loss and ADE/FDE are measured
    in; at most `episodes`."""
    path_states: int = 100  # along them, from which paths are compared
    n_jobs: int = 2  # processes that drive at the same time
    video_duration: float = 30.0  # longest evaluation drive shown in the video [s]; 0 makes none

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value, lowest = getattr(self, name), int(name in ("episodes", "n_jobs"))
            if not value >= lowest:
                raise ValueError(f"`{name}` must be at least {lowest}. Got {value}.")
