"""Files that no reader ever sees half of."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from uuid import uuid4

__all__ = ["write_json", "write_text"]


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write a JSON file in one step.

    Args:
        path: Target; folders above it are made.
        content: Entries; must not hold NaN or infinity.

    Raises:
        OSError: The file cannot be written.
        ValueError: If a number is not finite.
    """
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file in one step; folders above it are made.

    Raises:
        OSError: The file cannot be written; nothing is left beside it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name[:80]}.{os.getpid()}-{uuid4().hex[:8]}")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
