"""Two processes never train in one run folder."""

import multiprocessing
import time
from multiprocessing.synchronize import Event
from pathlib import Path

import pytest

from irl_dal.storage.checkpoint import CheckpointError, run_lock


def hold(folder: Path, held: Event) -> None:
    """Another process's work."""
    with run_lock(folder):
        held.set()
        time.sleep(60.0)


def test_a_second_process_is_refused_until_the_first_is_killed(tmp_path: Path) -> None:
    """One line that says `resume`; a killed process leaves nothing that must be removed by hand."""
    context = multiprocessing.get_context("fork")
    process = context.Process(target=hold, args=(tmp_path, held := context.Event()))
    process.start()
    try:
        assert held.wait(30.0)
        with pytest.raises(CheckpointError, match=f"resume = '{tmp_path}': another process"):
            with run_lock(tmp_path):
                pass
    finally:
        process.kill()
        process.join()
    with run_lock(tmp_path):
        pass


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    """A folder in the place of the lock cannot be written by anybody, root included."""
    (tmp_path / ".lock").mkdir()
    with pytest.raises(CheckpointError, match=f"resume = '{tmp_path}': cannot be written"):
        with run_lock(tmp_path):
            pass
