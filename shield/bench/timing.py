"""Timing that survives a busy machine: alternatives take turns on the same problem."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Timing", "take_turns"]

_TURN = 20  # [-] problems of a turn


@dataclass(frozen=True, slots=True)
class Timing:
    """Times of one alternative.

    Attributes:
        best: Smallest time of each problem on the processor [s], shape (problems,): what it takes
            where nothing else wants the processor or clears its caches.
    """

    best: NDArray[np.float64]

    def quantile(self, share: float) -> float:
        """Return a quantile over the problems [s]."""
        return float(np.quantile(self.best, share))


def take_turns(
    alternatives: Sequence[Callable[[int], object]], problems: int, rounds: int = 1
) -> list[Timing]:
    """Time alternatives on the same problems, in turns of a millisecond or so.

    In a turn an alternative runs a few problems one after the other, as it would in a loop: its own
    code and data are in the caches, and a warm start comes from another problem.

    Args:
        alternatives: Functions of the index of a problem.
        problems: Number of problems.
        rounds: How often all problems are run; one more round before them warms up.
    """
    times = np.empty((len(alternatives), rounds + 1, problems))
    for turn in range(rounds + 1):
        for start in range(0, problems, _TURN):
            for row, alternative in enumerate(alternatives):
                for problem in range(start, min(start + _TURN, problems)):
                    begin = time.thread_time()
                    alternative(problem)
                    times[row, turn, problem] = time.thread_time() - begin
    return [Timing(rows[1:].min(axis=0)) for rows in times]
