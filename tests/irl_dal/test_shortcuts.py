import ctypes
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import irl_dal
from irl_dal import shortcuts
from irl_dal.config import RunConfig
from irl_dal.storage.run_folder import create_run

SOURCE = Path(irl_dal.__file__).parent


def test_a_run_folder_records_the_short_cuts_in_use(tmp_path: Path) -> None:
    """`run.json` names each short cut and whether it was taken."""
    folder = create_run(tmp_path / "run", RunConfig())
    recorded = json.loads((folder.path / "run.json").read_text())["shortcuts"]
    assert recorded == shortcuts.in_use()
    assert recorded["compiled"] is True


def test_compiles_where_no_cache_can_be_written(tmp_path: Path) -> None:
    """A read-only installation of a user without a writable home compiles anew, and works."""
    package = tmp_path / "irl_dal"
    planner = package / "planner"
    planner.mkdir(parents=True)
    shutil.copy(SOURCE / "shortcuts.py", package)
    for folder in (package, planner):
        (folder / "__init__.py").write_text("")
        (folder / "__pycache__").write_text("a file: nobody can write into this folder")
    shutil.copy(SOURCE / "arrays.py", package)
    shutil.copy(SOURCE / "planner" / "rollout.py", planner)
    program = (
        "import numpy as np; from irl_dal.planner.rollout import ego_rollout;"
        "print(ego_rollout(np.ones((1, 2, 2)), 2.7, 0.1).x.shape)"
    )
    environment = os.environ | {
        "HOME": "/dev/null",
        "XDG_CACHE_HOME": "/dev/null",
        "PYTHONPATH": str(tmp_path),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.stdout.strip() == "(1, 2)", done.stderr


FAULTS = """
import resource
import numpy as np
from irl_dal.shortcuts import keep_freed_memory

def step():
    for _ in range(4):
        np.full(2**21, 1.0)  # 16 MiB each, as the activations of a gradient step
    parts = [np.full(2**21, 1.0) for _ in range(4)]

def faults():
    step()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(3):
        step()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

left = faults()
assert keep_freed_memory() and keep_freed_memory()  # every training of a process asks for it
print(left, faults())
"""


@pytest.mark.skipif(not hasattr(ctypes.pythonapi, "mallopt"), reason="needs glibc")
def test_the_pages_of_a_gradient_step_are_not_faulted_in_again() -> None:
    """Three rounds of the same arrays touch hardly a new page; left alone, all of theirs."""
    command = [sys.executable, "-c", FAULTS]
    done = subprocess.run(command, capture_output=True, check=True, text=True)
    left, kept = map(int, done.stdout.split())
    assert left > 100
    assert kept < left / 10
