"""Work is spread over processes, and kept if somebody says where."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.workers import Workers, without_interrupts
from irl_dal.storage.result_store import ResultStore
from tests.irl_dal.evaluation.small import small_config


def note(_rig: Rig, item: tuple[Path, int]) -> dict[str, int]:
    """Write down that an item was worked on; the fourth fails until something is fixed."""
    folder, number = item
    with (folder / "log").open("a") as log:
        log.write(f"{number} ")
    if not (folder / "fixed").exists() and number == 4:
        raise RuntimeError("on purpose")
    return {"number": number}


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_was_worked_out_before_a_failure_is_kept(tmp_path: Path, jobs: int) -> None:
    """Results come in the order of their items; an item is worked on until it succeeds."""
    items = [(tmp_path, number) for number in range(1, 5)]

    store = ResultStore(tmp_path / "kept")

    def work(store: ResultStore) -> list[int]:
        workers = Workers(small_config(), AgentSpec("random"), jobs)
        results = workers.map("noting", note, items, store, lambda item: str(item[1]))
        return [result["number"] for result in results]

    with pytest.raises(RuntimeError, match="on purpose"):
        work(store)
    (tmp_path / "fixed").touch()
    assert work(store) == [1, 2, 3, 4] == work(store)
    seen = (tmp_path / "log").read_text().split()
    assert seen.count("4") == 2 and seen.count("1") == 1
    workers = Workers(small_config(), AgentSpec("random"), 1)
    assert [done["number"] for done in workers.map("noting", note, items)] == [1, 2, 3, 4]
    assert (tmp_path / "log").read_text().split().count("1") == 2


def test_processes_started_without_interrupts_ignore_them() -> None:
    """And this one hears them again afterwards."""
    ignored = "import signal; print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"
    given = signal.signal(signal.SIGINT, signal.default_int_handler)  # also under nohup
    answers = []
    try:
        with without_interrupts():
            answers.append(subprocess.check_output([sys.executable, "-c", ignored], text=True))
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        answers.append(subprocess.check_output([sys.executable, "-c", ignored], text=True))
    finally:
        signal.signal(signal.SIGINT, given)
    assert [answer.strip() for answer in answers] == ["True", "False"]
