"""One process at a time trains in a run folder."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from irl_dal.storage.checkpoint import CheckpointError

__all__ = ["run_lock"]


@contextmanager
def run_lock(run_dir: Path) -> Iterator[None]:
    """Hold a run folder meanwhile; the system lets go of it when the process ends, however it ends.

    Evaluating needs no lock, so a folder that cannot be written can be evaluated.

    Raises:
        CheckpointError: If another process holds it, or the folder cannot be written.
    """
    name = repr(str(run_dir))
    try:
        file = (run_dir / ".lock").open("w")
    except OSError as error:
        raise CheckpointError(f"resume = {name}: cannot be written ({error.strerror})") from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise CheckpointError(f"resume = {name}: another process trains this run") from None
        yield
