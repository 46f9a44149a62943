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


def pytest_collection_finish() -> None:
    """The garbage collector need not look at half a million imported objects again and again."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Send a group to one process, the largest groups first.

    xdist's own `loadgroup` writes the group into a private attribute that pytest 9 does not read.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return group_of(nodeid)

    return Groups(config, log)
