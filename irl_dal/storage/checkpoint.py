"""Checkpoints: safetensors for arrays, JSON for the rest, never pickle.

    run/checkpoints/
      000012/state.json              counters, optimiser scalars, provenance
      000012/tensors.safetensors     every tensor and array of the state
      replay/000001.safetensors ...  what the replay buffer gained between two checkpoints

A checkpoint is written into a hidden folder that is then renamed; only after that the previous one
is removed, and shards are written before the checkpoint that counts them. A process may therefore
be killed at any moment: the newest folder is complete. File modes follow the umask.
"""

import fcntl
import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

FORMAT_VERSION = 2  # raised whenever a checkpoint of the previous code could be misread

# What torch, numpy and dictionaries raise when a state is loaded into something else.
MISFITS = (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError)

_STATE, _TENSORS = "state.json", "tensors.safetensors"

Arrays = dict[str, NDArray[Any]]


class CheckpointError(RuntimeError):
    """A checkpoint cannot be used or written; one line that names the run and what is wrong."""

    @classmethod
    def misfit(cls, path: Path, purpose: str, error: Exception) -> Self:
        """The line for an error of `MISFITS`."""
        what = shorten(str(error), 200)
        return cls(f"{path}: does not fit {purpose} ({type(error).__name__}: {what})")


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What was loaded."""

    folder: Path
    step: int  # environment steps at which it was written
    state: dict[str, Any]  # as it was handed to `CheckpointStore.save`
    provenance: dict[str, str]  # commit, config hash and whatever else the writer recorded
    shards: int  # number of replay shards that belong to it


class CheckpointStore:
    """The checkpoints of one run, in the folder `checkpoints` of its run folder."""

    def __init__(self, run_dir: Path) -> None:
        self.run_dir = run_dir
        self.folder = run_dir / "checkpoints"
        self._replay = self.folder / "replay"
        self._shards = 0

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
            provenance: Where it comes from.
            shard: What the replay buffer gained since the last checkpoint.
            final: The run is complete: remove the replay shards.

        Raises:
            TypeError: If the state holds something that is neither of these.
            CheckpointError: If an array is not finite; the older checkpoint stays.
        """
        arrays, skeleton = pack(state)
        _require_finite(arrays, f"{self.run_dir}: step {step}")
        if final:
            self._shards = 0
        elif shard is not None and len(next(iter(shard.values()))):
            self._replay.mkdir(parents=True, exist_ok=True)
            path = self._shard(self._shards + 1)
            partial = path.with_name(f".{path.name}.part")
            partial.write_bytes(save_arrays(dict(shard)))
            partial.replace(path)
            self._shards += 1
        document = {
            "format": FORMAT_VERSION,
            "step": step,
            "provenance": dict(provenance or {}),
            "tensors": {"file": _TENSORS},
            "shards": self._shards,
            "state": skeleton,
        }
        number = max((int(path.name) for path in self._complete()), default=0) + 1
        hidden = self.folder / f".{number:06d}.part"
        shutil.rmtree(hidden, ignore_errors=True)
        hidden.mkdir(parents=True)
        (hidden / _TENSORS).write_bytes(save_arrays(arrays))
        (hidden / _STATE).write_text(json.dumps(document), encoding="utf-8")
        target = hidden.rename(self.folder / f"{number:06d}")
        self._remove_others(target)
        if final:
            shutil.rmtree(self._replay, ignore_errors=True)
        return target

    def load(self) -> Checkpoint:
        """Read the newest checkpoint, without its shards.

        Raises:
            CheckpointError: If there is none, or it is of another version, damaged, truncated, or
                holds weights that are not finite.
        """
        if not self.run_dir.is_dir():
            raise CheckpointError(f"{self.run_dir}: there is no such run folder")
        complete = self._complete()
        if not complete:
            raise CheckpointError(f"{self.run_dir}: the run folder holds no checkpoint")
        folder = complete[-1]
        path = folder / _STATE
        try:
            document = _read(path, json.loads)
            written = document.get("format") if isinstance(document, dict) else None
            if written != FORMAT_VERSION:
                found = f"format {written} where this version reads {FORMAT_VERSION}"
                raise CheckpointError(f"{path}: {found}")
            arrays = _read(folder / document["tensors"]["file"], load_arrays)
            state = unpack(arrays, document["state"])
            parts = document["step"], state, document["provenance"], document["shards"]
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            what = f"{type(error).__name__}: {shorten(str(error), 100)}"
            raise CheckpointError(f"{path}: incomplete or damaged ({what})") from None
        if not all(map(isinstance, parts, (int, dict, dict, int))):
            raise CheckpointError(f"{path}: damaged, an entry is of the wrong kind")
        _require_finite(arrays, str(folder))
        return Checkpoint(folder, *parts)

    def resume(self) -> Checkpoint:
        """`load`, and go on writing after it, over the shards of an interval that was lost."""
        checkpoint = self.load()
        self._shards = checkpoint.shards
        self._remove_others(checkpoint.folder)
        return checkpoint

    def shards(self, checkpoint: Checkpoint) -> Iterator[Arrays]:
        """The replay shards of a checkpoint, oldest first, one in memory at a time."""
        return (_read(self._shard(i + 1), load_arrays) for i in range(checkpoint.shards))

    def _shard(self, number: int) -> Path:
        return self._replay / f"{number:06d}.safetensors"

    def _complete(self) -> list[Path]:
        return sorted(path for path in self.folder.glob("*") if path.name.isdecimal())

    def _remove_others(self, kept: Path) -> None:
        for path in [*self._complete(), *self.folder.glob(".*.part")]:
            if path != kept:
                shutil.rmtree(path)


def pack(state: Any) -> tuple[Arrays, Any]:
    """Split a nested state into arrays and a JSON document that says where each belongs."""
    arrays: Arrays = {}
    return arrays, _pack(state, "state", arrays)


def unpack(arrays: Mapping[str, NDArray[Any]], skeleton: Any) -> Any:
    """Put together what `pack` took apart."""
    if isinstance(skeleton, list):
        return [unpack(arrays, entry) for entry in skeleton]
    if not isinstance(skeleton, dict):
        return skeleton
    match skeleton["kind"]:
        case "tensor":
            return torch.from_numpy(arrays[skeleton["key"]].copy())
        case "array":
            return arrays[skeleton["key"]]
        case "tuple":
            return tuple(unpack(arrays, entry) for entry in skeleton["items"])
        case "dict":
            return {key: unpack(arrays, value) for key, value in skeleton["items"]}
    raise ValueError(f"there is no kind {skeleton['kind']!r}")


def _pack(value: Any, path: str, arrays: Arrays) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, torch.Tensor | np.ndarray):
        kind = "tensor" if isinstance(value, torch.Tensor) else "array"
        array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else value
        arrays[path] = np.ascontiguousarray(array).reshape(array.shape)
        return {"kind": kind, "key": path}
    if isinstance(value, Mapping):
        items = [[key, _pack(entry, f"{path}/{key}", arrays)] for key, entry in value.items()]
        return {"kind": "dict", "items": items}
    if isinstance(value, list | tuple):
        entries = [_pack(entry, f"{path}/{i}", arrays) for i, entry in enumerate(value)]
        return {"kind": "tuple", "items": entries} if isinstance(value, tuple) else entries
    raise TypeError(f"`{path}` cannot be stored in a checkpoint. Got a {type(value).__name__}.")


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


def _require_finite(arrays: Arrays, where: str) -> None:
    for name, values in arrays.items():
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise CheckpointError(f"{where}: {name} is not finite, the training diverged")


def _read(path: Path, parse: Callable[[bytes], Any]) -> Any:
    try:
        return parse(path.read_bytes())
    except FileNotFoundError:
        raise CheckpointError(f"{path}: the file is missing") from None
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError, SafetensorError) as error:
        what = shorten(str(error), 100)
        raise CheckpointError(f"{path}: truncated or damaged ({what})") from None
