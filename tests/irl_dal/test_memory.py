"""What becomes of memory that was freed."""

import ctypes
import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import numpy as np
from irl_dal.memory import keep_freed_memory

if sys.argv[1] == "keep":
    assert keep_freed_memory() and keep_freed_memory()  # every training of a process asks for it

def step():
    for _ in range(4):
        np.full(2**21, 1.0)  # 16 MiB each, as the activations of a gradient step
    parts = [np.full(2**21, 1.0) for _ in range(4)]

step()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    step()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not hasattr(ctypes.pythonapi, "mallopt"), reason="needs glibc")
def test_the_pages_of_a_gradient_step_are_not_faulted_in_again() -> None:
    """Ten rounds of the same arrays touch hardly a new page; left alone, all of theirs."""

    def faults(how: str) -> int:
        command = [sys.executable, "-c", FAULTS, how]
        return int(subprocess.run(command, capture_output=True, check=True, text=True).stdout)

    kept, left = faults("keep"), faults("leave")
    assert left > 100
    assert kept < left / 10
