"""How many threads torch and numpy compute on.

One, wherever something is driven: the matrices of a control step are too small to share, and idle
threads of two libraries that wait actively halve the speed. A gradient step is large enough for
two. Numbers depend on the count in their last digits, and on nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

import torch
from threadpoolctl import threadpool_limits

__all__ = ["GRADIENT_THREADS", "one_thread", "stay_on_one_thread", "threads"]

GRADIENT_THREADS = min(2, torch.get_num_threads())
"""Threads of a gradient step: as OMP_NUM_THREADS or the machine's cores say, two at most."""


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Compute on this number of threads meanwhile."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        with threadpool_limits(count, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)


def one_thread() -> AbstractContextManager[None]:
    """Compute on one thread meanwhile."""
    return threads(1)


def stay_on_one_thread() -> None:
    """Compute on one thread from now on."""
    torch.set_num_threads(1)
    threadpool_limits(1, user_api="blas")
