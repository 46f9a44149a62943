"""Results of single episodes, one JSON file each: what was driven once is not driven again.

    <folder>/<what>/<item>.json      `what` was measured, and of which item, usually a seed
    <folder>/.lock                   held by every evaluation that uses the folder

JSON holds numbers and text and nothing that runs: a folder may come from a stranger. Files appear
in one step, so processes may read and write the same folder at once.

A result may be read again only where driving would give the same one, so the folder's name is
`result_key`: the hash of the configuration, of the weights, of the code that drives, and of the
format of the files. The code counts as the interpreter reads it (`code_fingerprint`): a docstring
may change, a number may not. A constant raised by hand whenever behaviour changes would save more
drives, and would be forgotten: then numbers of two behaviours stand in one row without a word.
"""

import ast
import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import expert
import irl_dal
import shield
from irl_dal.storage.atomic import write_text

RESULT_FORMAT = 1  # raised whenever this version could misread the files of an older one

# Parts of `irl_dal` that no drive depends on. New parts count until they are named here.
SHOWING = ("bench", "cli", "figures", "sweep", "compare.py", "evaluate.py", "report.py", "train.py")


def result_key(settings: Mapping[str, Any], weights: Path | None = None) -> str:
    """Twelve hexadecimal digits that name all that a result depends on, beside its seed.

    `settings` are ready for JSON, without what changes no number (how many episodes, how many
    processes); `weights` is the folder of the checkpoint that drives, None without one.
    """
    text = json.dumps({"format": RESULT_FORMAT, "settings": settings}, sort_keys=True)
    files = () if weights is None else sorted(weights.iterdir())
    return fingerprint(text, code_fingerprint(), *files)


@dataclass(frozen=True, slots=True)
class ResultStore:
    """Results under one key: the folder's last part is a `result_key`, or says as much."""

    folder: Path

    def count(self) -> int:
        """Number of results."""
        return sum(1 for _ in self.folder.glob("*/*.json"))

    def get(self, what: str, item: int | str) -> dict[str, Any] | None:
        """A kept result; None where there is none, or none that can be read."""
        try:
            content = json.loads(self._path(what, item).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return dict(content) if isinstance(content, dict) else None

    def put(self, what: str, item: int | str, result: Mapping[str, Any]) -> None:
        """Keep a result; numbers that are not finite are kept too."""
        write_text(self._path(what, item), json.dumps(result))

    @contextmanager
    def until_complete(self) -> Iterator[None]:
        """Use the folder, and remove it in the end.

        It stays where the work was interrupted, or where another process still uses it; that one
        removes it then. Where no lock can be made nothing is removed.
        """
        lock = self._lock()
        try:
            yield
            if lock is not None and _only_user(lock):
                shutil.rmtree(self.folder, ignore_errors=True)
                with suppress(OSError):
                    self.folder.parent.rmdir()  # unless results under other keys are in it
        finally:
            if lock is not None:
                lock.close()

    def _path(self, what: str, item: int | str) -> Path:
        return self.folder / what / f"{item}.json"

    def _lock(self) -> IO[bytes] | None:
        """A shared lock on the folder; None where none can be made."""
        path = self.folder / ".lock"
        with suppress(OSError):
            for _ in range(3):
                self.folder.mkdir(parents=True, exist_ok=True)
                lock = path.open("ab")
                fcntl.flock(lock, fcntl.LOCK_SH)
                if os.fstat(lock.fileno()).st_nlink:
                    return lock
                lock.close()  # another process removed the folder while this one waited
        return None


def _only_user(lock: IO[bytes]) -> bool:
    """Whether no other process holds the lock; it is exclusive then."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def fingerprint(*parts: str | Path) -> str:
    """Twelve hexadecimal digits that change with any of the texts and of the files' bytes."""
    digest = hashlib.sha256()
    for part in parts:
        content = part.encode() if isinstance(part, str) else part.read_bytes()
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()[:12]


def code_fingerprint() -> str:
    """Twelve hexadecimal digits of the code that drives, plans and measures; takes about 0.7 s."""
    inside = (path for path in Path(irl_dal.__path__[0]).iterdir() if path.name not in SHOWING)
    roots = [*inside, Path(expert.__path__[0]), Path(shield.__path__[0])]
    files = {path for root in roots for path in [root, *root.rglob("*")]}
    sources = sorted(path for path in files if path.suffix == ".py")
    models = sorted(path for path in files if path.suffix == ".urdf")
    return fingerprint(*map(_meaning, sources), *models)


def _meaning(source: Path) -> str:
    """A module's syntax tree without its docstrings."""
    tree = ast.parse(source.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [
                entry
                for entry in node.body
                if not (isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant))
            ]
    return ast.dump(tree)
