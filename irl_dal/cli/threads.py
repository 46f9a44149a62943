"""How many threads torch and numpy compute on.

One for driving: the matrices of a control step are too small to share, and idle threads that wait
actively halve the speed. Two for a gradient step. Only the last digits depend on the count.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import torch
from threadpoolctl import threadpool_limits

# Threads of a gradient step: as OMP_NUM_THREADS or the machine's cores say, two at most.
GRADIENT_THREADS = min(2, torch.get_num_threads())


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


one_thread = partial(threads, 1)


def stay_on_one_thread() -> None:
    """Compute on one thread from now on."""
    torch.set_num_threads(1)
    threadpool_limits(1, user_api="blas")
