"""Timing that survives a busy machine: alternatives take turns on the same problem."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Timing", "take_turns"]

_TURN = 20


@dataclass(frozen=True, slots=True)
class Timing:
    """Times of one alternative.

    Attributes:
        wall: Wall times [s], shape (n,), sorted.
        cpu: Times of the calling thread on the processor [s], shape (n,), sorted: what the call
            takes where nothing else wants the processor.
        best: Smallest processor time of each problem [s], shape (problems,), sorted: neither do
            other processes clear the caches.
    """

    wall: NDArray[np.float64]
    cpu: NDArray[np.float64]
    best: NDArray[np.float64]

    def quantile(self, share: float) -> float:
        """Return a quantile of the wall times [s]."""
        return float(np.quantile(self.wall, share))

    def cpu_quantile(self, share: float) -> float:
        """Return a quantile of the processor times [s]."""
        return float(np.quantile(self.cpu, share))

    def best_quantile(self, share: float) -> float:
        """Return a quantile, over the problems, of the smallest processor times [s]."""
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
    wall = np.empty((len(alternatives), rounds, problems))
    cpu = np.empty_like(wall)
    for turn in range(-1, rounds):
        for start in range(0, problems, _TURN):
            for row, alternative in enumerate(alternatives):
                for problem in range(start, min(start + _TURN, problems)):
                    cpu_begin, begin = time.thread_time(), time.perf_counter()
                    alternative(problem)
                    end, cpu_end = time.perf_counter(), time.thread_time()
                    if turn >= 0:
                        wall[row, turn, problem] = end - begin
                        cpu[row, turn, problem] = cpu_end - cpu_begin
    return [
        Timing(np.sort(one.ravel()), np.sort(two.ravel()), np.sort(two.min(axis=0)))
        for one, two in zip(wall, cpu, strict=True)
    ]
