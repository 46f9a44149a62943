"""Checkpoints that survive `kill -9`: safetensors for arrays, JSON for the rest, never pickle.

    run/checkpoints/
      000012/state.json              counters, optimiser scalars, provenance, sizes and checksums
      000012/tensors.safetensors     every tensor and array of the state
      replay/000001.safetensors ...  append-only shards of the replay buffer

A checkpoint is written into a hidden folder, flushed to the disk and renamed; only then does the
previous one go. Shards are written before the checkpoint that names them, so whatever moment the
process dies at, the newest folder is complete and everything it names exists.
"""

from __future__ import annotations

import json
import os
import shutil
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file as load_arrays
from safetensors.numpy import save_file as save_arrays

__all__ = [
    "FORMAT_VERSION",
    "Checkpoint",
    "CheckpointError",
    "CheckpointStore",
    "FileRecord",
    "pack",
    "unpack",
]

FORMAT_VERSION = 1
"""Raised whenever a checkpoint of the previous code could be misread."""

Arrays = dict[str, NDArray[Any]]


class CheckpointError(RuntimeError):
    """A checkpoint cannot be used; the message is one line naming the file and what is wrong."""


@dataclass(frozen=True, slots=True)
class FileRecord:
    """A written file, as its checkpoint remembers it.

    Attributes:
        name: File name.
        size: Bytes.
        crc32: Checksum of the bytes.
    """

    name: str
    size: int
    crc32: int


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What was loaded.

    Attributes:
        folder: Where it lies.
        step: Environment steps at which it was written.
        state: Nested dictionaries, as they were handed to `CheckpointStore.save`.
        provenance: Commit, config hash and whatever else the writer wanted to be known.
        shards: Replay shards that belong to it, oldest first.
    """

    folder: Path
    step: int
    state: dict[str, Any]
    provenance: dict[str, str]
    shards: tuple[FileRecord, ...]


@dataclass(slots=True)
class CheckpointStore:
    """The checkpoints of one run.

    Attributes:
        run_dir: Run folder; everything is kept in its `checkpoints` folder.
    """

    run_dir: Path
    _shards: list[FileRecord] = field(default_factory=list)

    @property
    def folder(self) -> Path:
        """Where the checkpoints are."""
        return self.run_dir / "checkpoints"

    def save(
        self,
        state: Mapping[str, Any],
        *,
        step: int,
        provenance: Mapping[str, str] | None = None,
        shard: Mapping[str, NDArray[Any]] | None = None,
        final: bool = False,
    ) -> Path:
        """Write a checkpoint and then remove the older one.

        Args:
            state: Nested dictionaries, lists and tuples of tensors, arrays, numbers, strings, None.
            step: Environment steps so far.
            provenance: Commit, config hash, ...
            shard: What the replay buffer holds that no earlier shard has.
            final: The run is complete: name no shards and remove them all.

        Returns:
            The folder written.

        Raises:
            TypeError: If the state holds something that is neither of these.
        """
        if final:
            self._shards = []
        elif shard is not None and len(next(iter(shard.values()))):
            self._append(shard)
        arrays, skeleton = pack(state)
        number = max((int(path.name) for path in self._complete()), default=0) + 1
        hidden = self.folder / f".{number:06d}.part"
        shutil.rmtree(hidden, ignore_errors=True)
        hidden.mkdir(parents=True)
        document = {
            "format": FORMAT_VERSION,
            "step": step,
            "provenance": dict(provenance or {}),
            "tensors": asdict(_write_arrays(hidden / "tensors.safetensors", arrays)),
            "shards": [asdict(record) for record in self._shards],
            "state": skeleton,
        }
        _write_bytes(hidden / "state.json", json.dumps(document).encode())
        _flush_folder(hidden)
        target = hidden.rename(self.folder / f"{number:06d}")
        _flush_folder(self.folder)
        self._remove_others(target)
        if final:
            shutil.rmtree(self._replay, ignore_errors=True)
        return target

    def load(self) -> Checkpoint:
        """Read the newest checkpoint, without its shards.

        Raises:
            CheckpointError: If there is none, or it is of another version, damaged or truncated.
        """
        folder = self._newest()
        path = folder / "state.json"
        document = _read_document(path)
        try:
            record = FileRecord(**document["tensors"])
            shards = tuple(FileRecord(**entry) for entry in document["shards"])
            step, skeleton, provenance = (document[k] for k in ("step", "state", "provenance"))
        except (KeyError, TypeError) as error:
            raise CheckpointError(f"{path}: incomplete ({error})") from None
        arrays = _read_arrays(folder / record.name, record)
        return Checkpoint(folder, step, unpack(arrays, skeleton), provenance, shards)

    def resume(self) -> Checkpoint:
        """Read the newest checkpoint and go on writing after it.

        Shards that it does not name, of an interval that was lost, are removed.

        Raises:
            CheckpointError: As `load`; also if a shard is missing or damaged.
        """
        checkpoint = self.load()
        for record in checkpoint.shards:
            _check(self._replay / record.name, record)
        self._shards = list(checkpoint.shards)
        known = {record.name for record in self._shards}
        for path in self._replay.glob("*"):
            if path.name not in known:
                path.unlink()
        self._remove_others(checkpoint.folder)
        return checkpoint

    def shards(self, checkpoint: Checkpoint) -> Iterator[Arrays]:
        """The replay shards of a checkpoint, oldest first, one in memory at a time.

        Raises:
            CheckpointError: If one is missing or damaged.
        """
        for record in checkpoint.shards:
            yield _read_arrays(self._replay / record.name, record)

    @property
    def _replay(self) -> Path:
        return self.folder / "replay"

    def _append(self, shard: Mapping[str, NDArray[Any]]) -> None:
        self._replay.mkdir(parents=True, exist_ok=True)
        path = self._replay / f"{len(self._shards) + 1:06d}.safetensors"
        self._shards.append(_write_arrays(path, dict(shard)))
        _flush_folder(self._replay)

    def _newest(self) -> Path:
        if not self.run_dir.is_dir():
            raise CheckpointError(f"{self.run_dir}: there is no such run folder")
        found = self._complete()
        if not found:
            raise CheckpointError(f"{self.run_dir}: the run folder holds no checkpoint")
        return found[-1]

    def _complete(self) -> list[Path]:
        return sorted(path for path in self.folder.glob("*") if path.name.isdecimal())

    def _remove_others(self, kept: Path) -> None:
        for path in [*self._complete(), *self.folder.glob(".*.part")]:
            if path != kept:
                shutil.rmtree(path)


def pack(state: Any) -> tuple[Arrays, Any]:
    """Split a nested state into arrays and a JSON document that says where each belongs.

    Raises:
        TypeError: If something is neither a container, tensor, array, number, string nor None.
    """
    arrays: Arrays = {}
    return arrays, _pack(state, "state", arrays)


def unpack(arrays: Mapping[str, NDArray[Any]], skeleton: Any) -> Any:
    """Put together what `pack` took apart."""
    if isinstance(skeleton, list):
        return [unpack(arrays, entry) for entry in skeleton]
    if not isinstance(skeleton, dict):
        return skeleton
    kind = skeleton["kind"]
    if kind == "tensor":
        return torch.from_numpy(arrays[skeleton["key"]].copy())
    if kind == "array":
        return arrays[skeleton["key"]]
    if kind == "tuple":
        return tuple(unpack(arrays, entry) for entry in skeleton["items"])
    return {key: unpack(arrays, value) for key, value in skeleton["items"]}


def _pack(value: Any, path: str, arrays: Arrays) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, torch.Tensor | np.ndarray):
        tensor = isinstance(value, torch.Tensor)
        array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else value
        arrays[path] = np.ascontiguousarray(array).reshape(array.shape)
        return {"kind": "tensor" if tensor else "array", "key": path}
    if isinstance(value, Mapping):
        items = [[key, _pack(entry, f"{path}/{key}", arrays)] for key, entry in value.items()]
        return {"kind": "dict", "items": items}
    if isinstance(value, list | tuple):
        entries = [_pack(entry, f"{path}/{i}", arrays) for i, entry in enumerate(value)]
        return {"kind": "tuple", "items": entries} if isinstance(value, tuple) else entries
    raise TypeError(f"`{path}` cannot be stored in a checkpoint. Got a {type(value).__name__}.")


def _read_document(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise CheckpointError(f"{path}: the file is missing") from None
    except (ValueError, UnicodeDecodeError):
        raise CheckpointError(f"{path}: not valid JSON, truncated or damaged") from None
    found = document.get("format") if isinstance(document, dict) else None
    if found != FORMAT_VERSION:
        raise CheckpointError(f"{path}: format {found} where this version reads {FORMAT_VERSION}")
    return document


def _read_arrays(path: Path, record: FileRecord) -> Arrays:
    _check(path, record)
    try:
        return load_arrays(path)
    except SafetensorError as error:
        raise CheckpointError(f"{path}: not a safetensors file ({error})") from None


def _check(path: Path, record: FileRecord) -> None:
    if not path.is_file():
        raise CheckpointError(f"{path}: the file is missing")
    size = path.stat().st_size
    if size != record.size:
        raise CheckpointError(f"{path}: {size} bytes where {record.size} were written, truncated")
    if _crc32(path) != record.crc32:
        raise CheckpointError(f"{path}: the checksum differs, the file is damaged")


def _crc32(path: Path) -> int:
    checksum = 0
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            checksum = zlib.crc32(block, checksum)
    return checksum


def _write_arrays(path: Path, arrays: Arrays) -> FileRecord:
    hidden = path.with_name(f".{path.name}.part")
    save_arrays(arrays, hidden)
    with hidden.open("rb") as file:
        os.fsync(file.fileno())
    record = FileRecord(path.name, hidden.stat().st_size, _crc32(hidden))
    hidden.replace(path)
    return record


def _write_bytes(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
