"""Who computes on how many threads."""

import torch
from threadpoolctl import threadpool_info, threadpool_limits

from irl_dal.threads import one_thread


def blas_threads() -> set[int]:
    """What numpy's libraries may use."""
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_driving_takes_one_thread_and_gives_the_others_back() -> None:
    """In torch and in numpy, whatever they had before."""
    own = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with threadpool_limits(2, user_api="blas"):
            with one_thread():
                assert torch.get_num_threads() == 1
                assert blas_threads() == {1}
            assert (torch.get_num_threads(), blas_threads()) == (2, {2})
    finally:
        torch.set_num_threads(own)
