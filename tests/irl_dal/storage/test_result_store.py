"""Results of single episodes are kept, shared between processes and never executed."""

import json
import math
import multiprocessing
import pickle
from pathlib import Path

import pytest

from irl_dal.storage.result_store import ResultStore, result_key


@pytest.fixture
def store(tmp_path: Path) -> ResultStore:
    return ResultStore(tmp_path / "unfinished" / "key")


def test_what_was_put_is_got_to_the_last_bit(store: ResultStore) -> None:
    """Numbers of any size, none, text, and what is not finite; nothing else is known."""
    result = {"rows": [[0.1 + 0.2, 1e-300, -math.inf]], "name": "ü", "missing": None, "steps": 7}
    store.put("driving", 10_000, result)
    assert ResultStore(store.folder).get("driving", 10_000) == result
    assert store.get("driving", 10_001) is None and store.get("expert", 10_000) is None


class _Bomb:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return exec, ("raise SystemExit('executed')",)


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", pickle.dumps(_Bomb())])
def test_what_cannot_be_read_is_not_known(store: ResultStore, content: bytes) -> None:
    """Also a stranger's pickle: it is driven anew, and kept in its place."""
    store.put("driving", 1, {})
    (store.folder / "driving" / "1.json").write_bytes(content)
    assert store.get("driving", 1) is None
    store.put("driving", 1, {"steps": 2})
    assert store.get("driving", 1) == {"steps": 2}


def test_a_folder_in_which_nothing_can_be_written(tmp_path: Path) -> None:
    """Nothing is known, keeping says so, using it is possible."""
    (tmp_path / "unfinished").touch()
    store = ResultStore(tmp_path / "unfinished" / "key")
    with store.until_complete():
        assert store.get("driving", 1) is None
        with pytest.raises(OSError):
            store.put("driving", 1, {})


def test_complete_work_removes_its_folder_and_interrupted_work_keeps_it(
    store: ResultStore,
) -> None:
    """And other keys' folders stay."""
    neighbour = ResultStore(store.folder.with_name("other"))
    neighbour.put("driving", 1, {})
    with pytest.raises(KeyboardInterrupt), store.until_complete():
        store.put("driving", 1, {"steps": 1})
        raise KeyboardInterrupt
    assert store.get("driving", 1) == {"steps": 1}
    with store.until_complete():
        pass
    assert not store.folder.exists() and neighbour.get("driving", 1) == {}
    with neighbour.until_complete():
        pass
    assert not store.folder.parent.exists()


def _another(folder: Path, started: object, end: object) -> None:
    store = ResultStore(folder)
    with store.until_complete():
        store.put("driving", 2, {"steps": 2})
        started.set()  # type: ignore[attr-defined]
        assert end.wait(30)  # type: ignore[attr-defined]
        raise SystemExit(1)  # interrupted


def test_complete_work_leaves_what_another_process_has_driven(store: ResultStore) -> None:
    """Of two processes that use one folder, the first to be complete removes nothing."""
    context = multiprocessing.get_context("fork")
    started, end = context.Event(), context.Event()
    other = context.Process(target=_another, args=(store.folder, started, end))
    other.start()
    try:
        assert started.wait(60)
        with store.until_complete():
            store.put("driving", 1, {"steps": 1})
        assert store.get("driving", 2) == {"steps": 2}
    finally:
        end.set()
        other.join(30)
    assert store.get("driving", 1) and store.get("driving", 2)
    with store.until_complete():
        pass
    assert not store.folder.exists()


def test_the_key_changes_with_settings_and_weights(tmp_path: Path) -> None:
    """And with nothing else: neither with the order of the settings nor with the folder's name."""
    for name, content in (("a", b"1"), ("b", b"1"), ("c", b"2")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "tensors").write_bytes(content)
    first = result_key({"dt": 0.1, "n": 1}, tmp_path / "a")
    assert first == result_key(json.loads('{"n": 1, "dt": 0.1}'), tmp_path / "b")
    others = {result_key({"dt": 0.2, "n": 1}, tmp_path / "a"), result_key({"dt": 0.1, "n": 1})}
    assert len({first, result_key({"dt": 0.1, "n": 1}, tmp_path / "c")} | others) == 4
