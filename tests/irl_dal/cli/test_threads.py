"""Who computes on how many threads."""

import os
import subprocess
import sys

import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

from irl_dal.cli.threads import one_thread, threads


def blas_threads() -> set[int]:
    """What numpy's libraries may use."""
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_driving_takes_one_thread_and_gives_the_others_back() -> None:
    """In torch and in numpy, whatever they had before; a gradient step meanwhile takes two."""
    own = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with threadpool_limits(2, user_api="blas"):
            with one_thread():
                assert torch.get_num_threads() == 1
                assert blas_threads() == {1}
                with threads(2):
                    assert (torch.get_num_threads(), blas_threads()) == (2, {2})
                assert (torch.get_num_threads(), blas_threads()) == (1, {1})
            assert (torch.get_num_threads(), blas_threads()) == (2, {2})
    finally:
        torch.set_num_threads(own)


@pytest.mark.parametrize(("given", "used"), [("1", "1"), ("8", "2")])
def test_gradient_steps_take_what_the_process_was_given(given: str, used: str) -> None:
    """Two threads at most; whoever starts several runs at once says how many each has."""
    assert _print("GRADIENT_THREADS", OMP_NUM_THREADS=given).stdout.strip() == used


def test_a_process_that_only_drives_stays_on_one_thread() -> None:
    """Also when everything that could be collected has been."""
    script = (
        "import gc, torch; from threadpoolctl import threadpool_info;"
        "from irl_dal.cli.threads import stay_on_one_thread; stay_on_one_thread(); gc.collect();"
        "blas = {p['num_threads'] for p in threadpool_info() if p['user_api'] == 'blas'};"
        "print(torch.get_num_threads(), *blas)"
    )
    assert _run(script, OMP_NUM_THREADS="2").stdout.split() == ["1", "1"]


def _print(name: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """What a new process finds."""
    return _run(f"import irl_dal.cli.threads; print(irl_dal.cli.threads.{name})", **environment)


def _run(script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    known = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "GOMP_"))}
    return subprocess.run(
        [sys.executable, "-c", script],
        env=known | environment,
        capture_output=True,
        text=True,
        check=True,
    )
