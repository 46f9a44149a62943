"""Processes that drive, and a progress bar."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from irl_dal.cli.threads import one_thread
from irl_dal.config import RunConfig
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.storage.result_store import ResultStore

__all__ = ["CHUNK", "Workers", "progress_bar", "without_interrupts"]

Item = TypeVar("Item")
Result = TypeVar("Result")

CHUNK = 4
"""Largest number of items for which a process builds a rig: many enough to make building worth
while, few enough to share out."""


class Workers:
    """Spreads work over processes, each with a rig of its own, and shows how far it is.

    Args:
        config: What the rigs are built from.
        spec: Who drives in them.
        jobs: Number of processes.
        console: Where the progress bar goes; None shows none.
    """

    def __init__(
        self, config: RunConfig, spec: AgentSpec, jobs: int, console: Console | None
    ) -> None:
        self._subject = (config, spec)
        self._jobs = jobs
        self._progress = progress_bar(console)

    def __enter__(self) -> Workers:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def map(
        self, what: str, work: Callable[[Rig, Item], Result], items: Sequence[Item]
    ) -> list[Result]:
        """Results of `work` on each item, in their order."""
        return self._run(what, len(items), [(work, item, None) for item in items])

    def map_kept(
        self,
        what: str,
        work: Callable[[Rig, Item], dict[str, Any]],
        items: Sequence[Item],
        store: ResultStore,
        name: Callable[[Item], str] = str,
    ) -> list[dict[str, Any]]:
        """Results of `work` on each item, in their order, those of the store without any work.

        Each new result is kept as soon as it is there; where nothing can be written, none is.

        Args:
            what: Name of the work, in the store and in front of the progress bar.
            work: Returns what is ready for JSON.
            items: What it works on.
            store: Where results are kept.
            name: Of an item in the store.
        """
        known = {item: store.get(what, item) for item in map(name, items)}
        missing = [item for item in items if known[name(item)] is None]
        calls = [(work, item, (store, what, name(item))) for item in missing]
        new = dict(zip(map(name, missing), self._run(what, len(items), calls), strict=True))
        return [known[item] or new[item] for item in map(name, items)]

    def _run(self, what: str, total: int, calls: Sequence[Any]) -> list[Any]:
        if not calls:
            return []
        size = max(1, min(CHUNK, len(calls) // (2 * self._jobs)))
        chunks = [calls[start : start + size] for start in range(0, len(calls), size)]
        task = self._progress.add_task(what, total=total, completed=total - len(calls))
        results: list[Any] = []
        parallel = Parallel(n_jobs=min(self._jobs, len(chunks)), return_as="generator")
        with without_interrupts():
            running = parallel(delayed(_work)(*self._subject, chunk) for chunk in chunks)
        for done in running:
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


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Processes started meanwhile ignore Ctrl-C: this one gets it too, and ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _work(config: RunConfig, spec: AgentSpec, calls: Sequence[Any]) -> list[Any]:
    """In a process of its own: build, work, leave."""
    results = []
    with one_thread():
        rig = Rig.build(config, spec)
        try:
            for work, item, kept in calls:
                results.append(work(rig, item))
                if kept is not None:
                    store, what, name = kept
                    with suppress(OSError):  # a convenience: somebody else's folder
                        store.put(what, name, results[-1])
        finally:
            rig.close()
    return results
