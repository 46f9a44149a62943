"""A short hash of everything that a kept result depends on."""

import ast
import hashlib
from collections.abc import Iterable
from pathlib import Path

import expert
import irl_dal
import shield

__all__ = ["code_fingerprint", "fingerprint"]

# Parts of `irl_dal` that no drive depends on. New parts count until they are named here.
SHOWING = ("bench", "cli", "figures", "sweep", "compare.py", "evaluate.py", "report.py", "train.py")


def fingerprint(*parts: str | Path) -> str:
    """Twelve hexadecimal digits that change with any of the texts and of the files' bytes."""
    return _digest(part.encode() if isinstance(part, str) else part.read_bytes() for part in parts)


def code_fingerprint() -> str:
    """Twelve hexadecimal digits of the code that drives, plans and measures.

    Python counts as the interpreter reads it: comments, docstrings and layout change nothing, any
    other edit does. Takes about 0.7 s.
    """
    inside = (path for path in Path(irl_dal.__path__[0]).iterdir() if path.name not in SHOWING)
    roots = [*inside, Path(expert.__path__[0]), Path(shield.__path__[0])]
    files = {path for root in roots for path in [root, *root.rglob("*")]}
    sources = sorted(path for path in files if path.suffix == ".py")
    models = sorted(path for path in files if path.suffix == ".urdf")
    return _digest([*map(_meaning, sources), *(path.read_bytes() for path in models)])


def _meaning(source: Path) -> bytes:
    """A module's syntax tree without its docstrings."""
    tree = ast.parse(source.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [
                entry
                for entry in node.body
                if not (isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant))
            ]
    return ast.dump(tree).encode()


def _digest(contents: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for content in contents:
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()[:12]
