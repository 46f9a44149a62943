"""How two processes share the tests: what is made once for several files stays on one of them."""

import gc
from typing import Any

import pytest

GROUPS = {
    "trainings": ("irl_dal/test_commands.py", "irl_dal/sweep/"),
    "comparison": ("irl_dal/comparison/", "irl_dal/figures/test_comparison_page.py"),
    "short run": ("irl_dal/learning/test_pipeline.py", "irl_dal/learning/collection/"),
    "evaluation": ("irl_dal/evaluation/test_suite.py", "irl_dal/evaluation/test_workers.py"),
    "drives of the expert": ("expert/test_fsm.py",),
}
"""What is made once, and the files below `tests` that use it."""


def group_of(nodeid: str) -> str:
    """The group of a test; a test without a group is a group of its own."""
    file = nodeid.partition("::")[0].removeprefix("tests/")
    return next((name for name, files in GROUPS.items() if file.startswith(files)), nodeid)


def rank(nodeid: str) -> int:
    """When a test is handed out: 0 first.

    The trainings compile the planner, half a minute in a fresh clone. `shield` needs none of it and
    keeps the other process busy meanwhile; what comes later reads the machine code from the cache.
    """
    group = group_of(nodeid)
    if group == "trainings":
        return 0
    if nodeid.startswith("tests/shield/"):
        return 1
    return 3 if group == nodeid else 2


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The order in which two processes take the groups."""
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: rank(item.nodeid))


def pytest_collection_finish() -> None:
    """The garbage collector need not look at half a million imported objects again and again."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Send a group to one process, in the order of `rank`.

    xdist's own `loadgroup` writes the group into a private attribute that pytest 9 does not read.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return group_of(nodeid)

    config.option.loadscopereorder = False
    return Groups(config, log)
