"""Work is spread over processes, and kept if somebody says where."""

from pathlib import Path

import pytest

from irl_dal.evaluation.rig import AgentSpec, Bench
from irl_dal.evaluation.workers import Workers
from tests.irl_dal.evaluation.small import small_config


def note(_bench: Bench, item: tuple[Path, int]) -> int:
    """Write down that an item was worked on; the fourth fails until something is fixed."""
    folder, number = item
    with (folder / "log").open("a") as log:
        log.write(f"{number} ")
    if not (folder / "fixed").exists() and number == 4:
        raise RuntimeError("on purpose")
    return number


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_was_worked_out_before_a_failure_is_kept(tmp_path: Path, jobs: int) -> None:
    """Results come in the order of their items; an item is worked on until it succeeds."""
    items = [(tmp_path, number) for number in range(1, 5)]

    def work(kept: Path | None) -> list[int]:
        with Workers(small_config(), AgentSpec("random"), jobs, None, kept) as workers:
            return workers.map("noting", note, items)

    with pytest.raises(RuntimeError, match="on purpose"):
        work(tmp_path / "kept")
    (tmp_path / "fixed").touch()
    assert work(tmp_path / "kept") == [1, 2, 3, 4] == work(tmp_path / "kept")
    seen = (tmp_path / "log").read_text().split()
    assert seen.count("4") == 2 and seen.count("1") == 1
    assert work(None) == [1, 2, 3, 4]
    assert (tmp_path / "log").read_text().split().count("1") == 2
