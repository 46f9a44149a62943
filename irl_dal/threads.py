"""How many threads torch and numpy compute on.

The matrices of one control step are small. Handing them to a second thread costs more than it
saves, and two libraries whose idle threads both wait actively slow a drive down to half its speed.
One thread also makes the numbers depend on nothing else. Gradient steps are large enough for two:
they get back what `one_thread` took. Both obey OMP_NUM_THREADS, and so do the runs of a sweep.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from threadpoolctl import threadpool_limits

__all__ = ["gradient_threads", "one_thread"]

GRADIENT_THREADS = 2
"""Most threads of a gradient step; batches of some hundred samples feed no more."""

_taken: ContextVar[int] = ContextVar("taken", default=1)
"""How many threads torch had before `one_thread`."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread meanwhile."""
    threads = torch.get_num_threads()
    token = _taken.set(threads)
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(threads)
        _taken.reset(token)


@contextmanager
def gradient_threads() -> Iterator[None]:
    """Within `one_thread`: let torch have its threads back meanwhile, two at most."""
    threads = torch.get_num_threads()
    torch.set_num_threads(max(threads, min(_taken.get(), GRADIENT_THREADS)))
    try:
        yield
    finally:
        torch.set_num_threads(threads)
