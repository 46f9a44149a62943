"""How many threads torch and numpy compute on.

The matrices of one control step are small. Handing them to a second thread costs more than it
saves, and two libraries whose idle threads both wait actively slow a drive down to half its speed:
everything is driven on one thread. A gradient step is large enough for two.

Numbers depend on the count in their last digits, and on nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

import torch
from threadpoolctl import threadpool_limits

__all__ = ["GRADIENT_THREADS", "one_thread", "stay_on_one_thread", "threads"]

GRADIENT_THREADS = min(2, torch.get_num_threads())
"""Threads of a gradient step: what the process was given by OMP_NUM_THREADS, by the launcher of a
sweep or by the machine's cores, and two at most."""


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Compute on so many threads meanwhile."""
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
