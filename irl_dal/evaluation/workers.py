"""Processes that drive, and a progress bar."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from joblib import Memory, Parallel, delayed
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from irl_dal.cli.threads import one_thread
from irl_dal.config import RunConfig
from irl_dal.evaluation.rig import AgentSpec, Bench

__all__ = ["CHUNK", "Workers", "progress_bar"]

Item = TypeVar("Item")
Result = TypeVar("Result")

CHUNK = 4
"""Largest number of items that a process works on before it reports."""


class Workers:
    """Spreads work over processes, each with a bench of its own, and shows how far it is.

    Args:
        config: What the benches are built from.
        spec: Who drives in them.
        jobs: Number of processes.
        console: Where the progress bar goes; None shows none.
        kept: Folder for results, of this configuration and agent alone: what is in it is not
            worked out again. None keeps nothing.
    """

    def __init__(
        self,
        config: RunConfig,
        spec: AgentSpec,
        jobs: int,
        console: Console | None,
        kept: Path | None = None,
    ) -> None:
        self._config = config
        self._spec = spec
        self._jobs = jobs
        self._progress = progress_bar(console)
        memory = Memory(kept, verbose=0)
        self._work = memory.cache(_work, ignore=["config", "spec"])

    def __enter__(self) -> Workers:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def map(
        self, what: str, work: Callable[[Bench, Item], Result], items: Sequence[Item]
    ) -> list[Result]:
        """Results of `work` on each item, in their order."""
        if not items:
            return []
        size = max(1, min(CHUNK, len(items) // (2 * self._jobs)))
        chunks = [items[start : start + size] for start in range(0, len(items), size)]
        task = self._progress.add_task(what, total=len(items))
        results: list[Result] = []
        parallel = Parallel(n_jobs=min(self._jobs, len(chunks)), return_as="generator")
        calls = (delayed(self._work)(self._config, self._spec, work, chunk) for chunk in chunks)
        for done in parallel(calls):
            results += done
            self._progress.advance(task, len(done))
        return results


def progress_bar(console: Console | None) -> Progress:
    """A bar per kind of work; None shows none."""
    return Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=console is None,
    )


def _work(
    config: RunConfig,
    spec: AgentSpec,
    work: Callable[[Bench, Item], Result],
    items: Iterable[Item],
) -> list[Result]:
    """In a process of its own: build, work, leave."""
    with one_thread():
        bench = Bench.build(config, spec)
        try:
            return [work(bench, item) for item in items]
        finally:
            bench.close()
