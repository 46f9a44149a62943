"""Two processes never train in one run folder."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from irl_dal.storage.checkpoint import CheckpointError, run_lock

HOLDER = """
import sys, time
from pathlib import Path
from irl_dal.storage.checkpoint import run_lock
with run_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_process_is_refused_until_the_first_is_killed(tmp_path: Path) -> None:
    """One line that says `resume`; a killed process leaves nothing that must be removed by hand."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        with pytest.raises(CheckpointError, match=f"resume = '{tmp_path}': another process"):
            with run_lock(tmp_path):
                pass
        process.send_signal(signal.SIGKILL)
    with run_lock(tmp_path):
        pass


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    """A folder in the place of the lock cannot be written by anybody, root included."""
    (tmp_path / ".lock").mkdir()
    with pytest.raises(CheckpointError, match=f"resume = '{tmp_path}': cannot be written"):
        with run_lock(tmp_path):
            pass
