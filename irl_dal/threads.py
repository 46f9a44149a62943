"""How many threads torch and numpy compute on.

The matrices of one control step are small. Handing them to a second thread costs more than it
saves, and two libraries whose idle threads both wait actively slow a drive down to half its speed.
Driving is therefore done on one thread. Gradient steps on batches of images gain from all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from threadpoolctl import threadpool_limits

__all__ = ["AVAILABLE", "all_threads", "one_thread"]

AVAILABLE = torch.get_num_threads()
"""Threads that torch begins with: one a core, or what `OMP_NUM_THREADS` says."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread meanwhile."""
    with _torch_threads(1), threadpool_limits(1, user_api="blas"):
        yield


@contextmanager
def all_threads() -> Iterator[None]:
    """Let torch compute on all threads meanwhile, for gradient steps inside of `one_thread`."""
    with _torch_threads(AVAILABLE):
        yield


@contextmanager
def _torch_threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
