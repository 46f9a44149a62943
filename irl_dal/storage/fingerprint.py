"""A short hash of everything that kept results depend on."""

from __future__ import annotations

import hashlib
from pathlib import Path

__all__ = ["fingerprint"]

SOURCES = (".py", ".urdf")
"""Endings of the files in a folder that count."""


def fingerprint(*parts: str | Path) -> str:
    """Twelve hexadecimal digits that change with any of the parts.

    Args:
        parts: Texts, files, and folders with all the sources below them.
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, str):
            digest.update(part.encode())
            continue
        for path in _files(part):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return sorted(entry for entry in path.rglob("*") if entry.suffix in SOURCES)
