"""How many threads torch and numpy compute on.

The matrices of one control step are small. Handing them to a second thread costs more than it
saves, and two libraries whose idle threads both wait actively slow a drive down to half its speed.
One thread also makes the numbers depend on nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from threadpoolctl import threadpool_limits

__all__ = ["one_thread"]


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread meanwhile."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(threads)
