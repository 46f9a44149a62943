"""Checkpoints: complete or not there, and never a line of code in them."""

import contextlib
import json
import multiprocessing
import os
import stat
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file
from torch import nn

from irl_dal.storage.checkpoint import (
    FORMAT_VERSION,
    CheckpointError,
    CheckpointStore,
    pack,
    unpack,
)


def shard(first: int, rows: int) -> dict[str, np.ndarray]:
    """Rows of a replay export."""
    return {"serial": np.arange(first, first + rows), "value": np.ones((rows, 3), np.float32)}


def stored(run_dir: Path, step: int = 10) -> CheckpointStore:
    """A run folder with one checkpoint and two shards."""
    store = CheckpointStore(run_dir)
    store.save({"step": 5}, step=5, shard=shard(0, 4))
    weights = torch.arange(1000, dtype=torch.float32)
    provenance = {"commit": "abc"}
    store.save({"weights": weights}, step=step, provenance=provenance, shard=shard(4, 6))
    return store


def equal(first: Any, second: Any) -> bool:
    """Same nesting, same types, same values."""
    if type(first) is not type(second):
        return False
    if isinstance(first, dict):
        same = list(first) == list(second)
        return same and all(equal(first[key], second[key]) for key in first)
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(equal, first, second))
    if isinstance(first, torch.Tensor):
        return first.dtype == second.dtype and torch.equal(first, second)
    if isinstance(first, np.ndarray):
        return first.dtype == second.dtype and np.array_equal(first, second)
    return bool(first == second)


def test_states_of_optimisers_schedulers_and_generators_come_back_equal(tmp_path: Path) -> None:
    """Everything that training needs survives the disk, with its types."""
    network = nn.Linear(3, 2)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(optimizer, patience=1)
    network(torch.ones(4, 3)).sum().backward()
    optimizer.step()
    scheduler.step(0.5)
    rng = np.random.default_rng(7)
    generator = torch.Generator().manual_seed(3)
    state = {
        "network": dict(network.state_dict()),
        "optimizer": optimizer.state_dict(),
        "scheduler": scheduler.state_dict(),
        "rng": rng.bit_generator.state,
        "generator": generator.get_state(),
        "misc": {
            "inf": float("inf"),
            "none": None,
            "pair": (1, "a"),
            "list": [True, 2.5],
            3: "int",
        },
        "arrays": {
            "flags": np.array([True, False]),
            "scalar": np.array(3),
            "empty": np.zeros((0, 2)),
        },
    }
    CheckpointStore(tmp_path).save(state, step=12)
    loaded = CheckpointStore(tmp_path).load()
    assert loaded.step == 12
    assert equal(loaded.state, state)
    twin = nn.Linear(3, 2)
    again = torch.optim.Adam(twin.parameters(), lr=1.0)
    again.load_state_dict(loaded.state["optimizer"])
    assert again.param_groups[0]["lr"] == 1e-3
    other = np.random.default_rng(0)
    other.bit_generator.state = loaded.state["rng"]
    assert np.array_equal(rng.random(5), other.random(5))


def test_only_the_newest_checkpoint_is_kept(tmp_path: Path) -> None:
    """An older checkpoint goes when the newer one is complete; a run of any length stays small."""
    store = stored(tmp_path, step=10)
    store.save({"a": 1}, step=20)
    assert [p.name for p in sorted((tmp_path / "checkpoints").iterdir())] == ["000003", "replay"]
    assert store.load().step == 20


def test_saving_twice_at_one_step_never_leaves_a_moment_without_a_checkpoint(
    tmp_path: Path,
) -> None:
    """The second checkpoint of a step gets a folder of its own."""
    store = CheckpointStore(tmp_path)
    first = store.save({"a": 1}, step=10)
    second = store.save({"a": 2}, step=10)
    assert first != second
    assert store.load().state == {"a": 2}


def test_shards_are_read_in_order_and_lost_ones_are_overwritten(tmp_path: Path) -> None:
    """A resumed run has the shards that its checkpoint counts, not those of a lost interval."""
    stored(tmp_path)
    lost = tmp_path / "checkpoints" / "replay" / "000003.safetensors"
    lost.write_bytes(b"of an interval that was lost")
    store = CheckpointStore(tmp_path)
    checkpoint = store.resume()
    serials = np.concatenate([arrays["serial"] for arrays in store.shards(checkpoint)])
    assert np.array_equal(serials, np.arange(10))
    store.save({}, step=20, shard=shard(10, 2))
    loaded = store.load()
    assert loaded.shards == 3
    assert np.array_equal([*store.shards(loaded)][2]["serial"], [10, 11])
    assert checkpoint.provenance == {"commit": "abc"}


def test_a_complete_run_keeps_no_shards(tmp_path: Path) -> None:
    """The final checkpoint drops the replay buffer from the disk."""
    store = stored(tmp_path)
    store.save({"a": 1}, step=20, final=True)
    assert not (tmp_path / "checkpoints" / "replay").exists()
    assert CheckpointStore(tmp_path).resume().shards == 0


def damage(path: Path, keep: float) -> None:
    """Cut a file."""
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * keep)])


@pytest.mark.parametrize("name", ["state.json", "tensors.safetensors"])
@pytest.mark.parametrize("keep", [0.0, 0.5, 0.99])
def test_a_truncated_file_is_named(tmp_path: Path, name: str, keep: float) -> None:
    """However much is missing, the error is one line with the file in it."""
    stored(tmp_path)
    path = tmp_path / "checkpoints" / "000002" / name
    damage(path, keep)
    with pytest.raises(CheckpointError, match=f"{path}.*truncated") as caught:
        CheckpointStore(tmp_path).load()
    assert "\n" not in str(caught.value)


def change(run_dir: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """Edit `state.json` of the newest checkpoint; gives its path."""
    path = run_dir / "checkpoints" / "000002" / "state.json"
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize(
    "edit",
    [
        lambda d: d.update(state={"items": []}),
        lambda d: d.update(state={"kind": "other", "items": []}),
        lambda d: d.update(state={"kind": "dict", "items": [["a"]]}),
        lambda d: d.update(state={"kind": "dict", "items": [[["unhashable"], 1]]}),
        lambda d: d.update(state={"kind": "dict", "items": 5}),
        lambda d: d.update(state={"kind": ["dict"], "items": []}),
        lambda d: d.update(state={"kind": "tensor"}),
        lambda d: d.update(state=[1, 2]),
        lambda d: d["state"]["items"].append(["more", {"kind": "array", "key": "state/more"}]),
        lambda d: d["state"]["items"].append(["more", {"kind": "array", "key": ["state"]}]),
        lambda d: d.update(step="ten"),
        lambda d: d.update(provenance=None),
        lambda d: d.update(shards=["000001.safetensors"]),
        lambda d: d.update(tensors=7),
        lambda d: d.update(tensors={}),
        lambda d: d.pop("tensors"),
        lambda d: d.pop("step"),
    ],
)
def test_a_damaged_document_is_one_line(
    tmp_path: Path, edit: Callable[[dict[str, Any]], object]
) -> None:
    """Valid JSON of the right format that no checkpoint has: the error names the run."""
    stored(tmp_path)
    path = change(tmp_path, edit)
    with pytest.raises(CheckpointError, match=f"{path}.*damaged") as caught:
        CheckpointStore(tmp_path).load()
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.parametrize("text", ["[" * 100_000 + "]" * 100_000, "\x00", "", '{"format": 2', "nan"])
def test_text_that_is_no_document_is_one_line(tmp_path: Path, text: str) -> None:
    """Too deeply nested, binary, empty, cut: the error names the run."""
    stored(tmp_path)
    path = tmp_path / "checkpoints" / "000002" / "state.json"
    path.write_text(text)
    with pytest.raises(CheckpointError, match=str(path)):
        CheckpointStore(tmp_path).load()


def test_a_nested_state_is_one_line(tmp_path: Path) -> None:
    """Deep enough for the recursion of `unpack`, not for that of the JSON reader."""
    stored(tmp_path)
    path = tmp_path / "checkpoints" / "000002" / "state.json"
    text = json.dumps(json.loads(path.read_text()) | {"state": "HERE"})
    path.write_text(text.replace('"HERE"', "[" * 900 + "]" * 900))
    with pytest.raises(CheckpointError, match=str(path)):
        CheckpointStore(tmp_path).load()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_weights_that_are_not_finite_are_refused(tmp_path: Path, value: float) -> None:
    """One such weight is enough; the error names the run and the tensor."""
    stored(tmp_path)
    path = tmp_path / "checkpoints" / "000002" / "tensors.safetensors"
    tensors = load_file(path)
    tensors["state/weights"][7] = value
    save_file(tensors, path)
    with pytest.raises(CheckpointError, match=f"{path.parent}: state/weights is not finite"):
        CheckpointStore(tmp_path).load()


def test_a_diverged_state_does_not_replace_a_good_checkpoint(tmp_path: Path) -> None:
    """The run stops with the step in the error, and what was saved before is still there."""
    store = stored(tmp_path)
    weights = torch.tensor([1.0, float("nan")])
    with pytest.raises(CheckpointError, match=f"{tmp_path}: step 20: state/w is not finite"):
        store.save({"w": weights}, step=20, shard=shard(10, 2))
    assert CheckpointStore(tmp_path).resume().step == 10


@pytest.mark.parametrize("umask", [0o022, 0o027, 0o077])
def test_the_umask_decides_who_can_read(tmp_path: Path, umask: int) -> None:
    """Files and folders alike: a group can evaluate a colleague's run if the umask says so."""
    before = os.umask(umask)
    try:
        stored(tmp_path / "run")
    finally:
        os.umask(before)
    for path in [tmp_path / "run", *(tmp_path / "run").rglob("*")]:
        whole = 0o777 if path.is_dir() else 0o666
        assert stat.S_IMODE(path.stat().st_mode) == whole & ~umask, path


def test_missing_empty_and_foreign_runs_are_refused(tmp_path: Path) -> None:
    """No folder, a folder without a checkpoint, another version, a missing file or shard."""
    with pytest.raises(CheckpointError, match=f"{tmp_path / 'none'}: there is no such run folder"):
        CheckpointStore(tmp_path / "none").load()
    with pytest.raises(CheckpointError, match=f"{tmp_path}: the run folder holds no checkpoint"):
        CheckpointStore(tmp_path).load()
    stored(tmp_path)
    (tmp_path / "checkpoints" / "replay" / "000001.safetensors").unlink()
    store = CheckpointStore(tmp_path)
    with pytest.raises(CheckpointError, match=r"000001\.safetensors: the file is missing"):
        list(store.shards(store.resume()))
    path = tmp_path / "checkpoints" / "000002" / "state.json"
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"format": FORMAT_VERSION + 1}))
    with pytest.raises(CheckpointError, match=f"format {FORMAT_VERSION + 1} where this version"):
        CheckpointStore(tmp_path).load()
    del document["tensors"]
    path.write_text(json.dumps(document))
    with pytest.raises(CheckpointError, match="incomplete"):
        CheckpointStore(tmp_path).load()
    path.write_text("[1, 2]")
    with pytest.raises(CheckpointError, match="format None"):
        CheckpointStore(tmp_path).load()


def test_what_cannot_be_stored_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    """No pickle for the rest: an object of any other kind is an error that says where it is."""
    store = CheckpointStore(tmp_path)
    with pytest.raises(TypeError, match="`state/a/b` cannot be stored"):
        store.save({"a": {"b": object()}}, step=1)
    with pytest.raises(CheckpointError, match="holds no checkpoint"):
        store.load()


def test_pack_keeps_every_array_once() -> None:
    """The JSON part holds no numbers of arrays, the arrays no structure."""
    arrays, skeleton = pack({"x": [np.ones(3), {"y": torch.zeros(2)}]})
    assert sorted(arrays) == ["state/x/0", "state/x/1/y"]
    assert equal(unpack(arrays, json.loads(json.dumps(skeleton)))["x"][1]["y"], torch.zeros(2))


def keep_saving(run_dir: Path, said: Connection) -> None:
    """Another process's work; OpenMP's other threads do not survive a fork."""
    torch.set_num_threads(1)
    store = CheckpointStore(run_dir)
    for step in range(1, 10_000):
        serials = np.arange(8 * (step - 1), 8 * step)
        rows = {"serial": serials, "value": np.full((8, 2000), float(step))}
        store.save({"step": step, "w": torch.full((50_000,), float(step))}, step=step, shard=rows)
        said.send(step)


def test_kill_9_at_any_moment_leaves_a_usable_checkpoint(tmp_path: Path) -> None:
    """Killed at random moments while it writes, a run resumes from what it last said was saved."""
    rng = np.random.default_rng(0)
    for attempt in range(3):
        run_dir = tmp_path / str(attempt)
        heard, told = multiprocessing.Pipe(duplex=False)
        context = multiprocessing.get_context("fork")
        process = context.Process(target=keep_saving, args=(run_dir, told))
        process.start()
        told.close()
        said = heard.recv()
        time.sleep(float(rng.uniform(0.0, 0.05)))
        process.kill()
        process.join()
        with contextlib.suppress(EOFError):
            while True:
                said = heard.recv()
        store = CheckpointStore(run_dir)
        checkpoint = store.resume()
        assert said <= checkpoint.step <= said + 1
        assert torch.equal(checkpoint.state["w"], torch.full((50_000,), float(checkpoint.step)))
        rows = [arrays["serial"] for arrays in store.shards(checkpoint)]
        assert np.array_equal(np.concatenate(rows), np.arange(8 * checkpoint.step))
