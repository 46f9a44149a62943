"""Files that no reader ever sees half of."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from uuid import uuid4


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """`write_text` of JSON; raises ValueError if a number is not finite."""
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
    finally:
        partial.unlink(missing_ok=True)
