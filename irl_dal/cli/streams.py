"""Where a command's results go: the terminal, and the file or folder that `out=` names."""

from __future__ import annotations

import sys
import tempfile
from io import TextIOWrapper
from pathlib import Path

from irl_dal.config import ConfigError

__all__ = ["replace_unknown_characters", "require_writable"]


def replace_unknown_characters() -> None:
    """Let a terminal or a log that knows no UTF-8 show `?` where it cannot show a character."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


def require_writable(key: str, path: Path, *, folder: bool = False) -> None:
    """Refuse a target that cannot be written, before anything is computed for it.

    Makes the folder that the target will lie in, or that it is.

    Args:
        key: Configuration key that names it.
        path: The target; need not exist.
        folder: It is a folder.

    Raises:
        ConfigError: Nothing can be written there.
    """
    where = f"{key} = {str(path)!r}"
    try:
        if path.exists() and (not path.is_dir() if folder else not path.is_file()):
            raise ConfigError(f"{where}: is {'a file' if folder else 'a folder or a device'}")
        place = path if folder else path.parent
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise ConfigError(f"{where}: cannot be written ({error.strerror})") from None
