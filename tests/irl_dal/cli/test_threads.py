"""Who computes on how many threads."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

import irl_dal
from irl_dal.cli.threads import one_thread, threads

SOURCE = Path(irl_dal.__file__).parent / "cli" / "threads.py"


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


@pytest.mark.parametrize(("given", "used"), [(1, 1), (8, 2)])
def test_gradient_steps_take_what_the_process_was_given(given: int, used: int) -> None:
    """Two threads at most; whoever starts several runs at once says how many each has."""
    own = torch.get_num_threads()
    try:
        torch.set_num_threads(given)
        assert runpy.run_path(str(SOURCE))["GRADIENT_THREADS"] == used
    finally:
        torch.set_num_threads(own)


def test_a_process_that_only_drives_stays_on_one_thread() -> None:
    """Also when everything that could be collected has been; before, it was given eight."""
    script = (
        "import gc, torch; from threadpoolctl import threadpool_info;"
        "from irl_dal.cli.threads import GRADIENT_THREADS, stay_on_one_thread;"
        "stay_on_one_thread(); gc.collect();"
        "blas = {p['num_threads'] for p in threadpool_info() if p['user_api'] == 'blas'};"
        "print(GRADIENT_THREADS, torch.get_num_threads(), *blas)"
    )
    known = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "GOMP_"))}
    command, given = [sys.executable, "-c", script], known | {"OMP_NUM_THREADS": "8"}
    printed = subprocess.run(command, env=given, capture_output=True, text=True, check=True).stdout
    assert printed.split() == ["2", "1", "1"]
