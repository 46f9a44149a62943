"""Timing that survives a busy machine: alternatives take turns on the same problem."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Timing", "take_turns"]


@dataclass(frozen=True, slots=True)
class Timing:
    """Times of one alternative.

    Attributes:
        wall: Wall times [s], shape (n,), sorted.
        cpu: Times of the calling thread on the processor [s], shape (n,), sorted: what the call
            takes where nothing else wants the processor.
    """

    wall: NDArray[np.float64]
    cpu: NDArray[np.float64]

    def quantile(self, share: float) -> float:
        """Return a quantile of the wall times [s]."""
        return float(np.quantile(self.wall, share))

    def cpu_quantile(self, share: float) -> float:
        """Return a quantile of the processor times [s]."""
        return float(np.quantile(self.cpu, share))


def take_turns(
    alternatives: Sequence[Callable[[int], object]], problems: int, rounds: int = 1
) -> list[Timing]:
    """Time alternatives on the same problems, one problem after the other.

    Args:
        alternatives: Functions of the index of a problem.
        problems: Number of problems.
        rounds: How often all problems are run; one more round before them warms up.
    """
    wall = np.empty((len(alternatives), rounds, problems))
    cpu = np.empty_like(wall)
    for turn in range(-1, rounds):
        for problem in range(problems):
            for row, alternative in enumerate(alternatives):
                cpu_begin, begin = time.thread_time(), time.perf_counter()
                alternative(problem)
                end, cpu_end = time.perf_counter(), time.thread_time()
                if turn >= 0:
                    wall[row, turn, problem] = end - begin
                    cpu[row, turn, problem] = cpu_end - cpu_begin
    return [
        Timing(np.sort(one.ravel()), np.sort(two.ravel()))
        for one, two in zip(wall, cpu, strict=True)
    ]
