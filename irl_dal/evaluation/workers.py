"""Processes that drive, and a progress bar."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from irl_dal.cli.threads import one_thread
from irl_dal.config import RunConfig
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.storage.result_store import ResultStore

Item = TypeVar("Item")

CHUNK = 4
"""Largest number of items for which a process builds a rig: many enough to make building worth
while, few enough to share out."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Spreads work over `jobs` processes, each with a rig of its own, and shows how far it is."""

    config: RunConfig
    spec: AgentSpec
    jobs: int
    console: Console | None = None

    def map(
        self,
        what: str,
        work: Callable[[Rig, Item], Any],
        items: Sequence[Item],
        store: ResultStore | None = None,
        name: Callable[[Item], str] = str,
    ) -> list[Any]:
        """Results of `work` on each item, in their order; `what` stands before the progress bar.

        A store needs results ready for JSON: those in it, under `what` and the item's `name`, are
        read, and each new one is kept as soon as it is there, as far as anything can be written.
        """
        known = [None if store is None else store.get(what, name(item)) for item in items]
        calls = [
            (work, item, None if store is None else (store, what, name(item)))
            for item, result in zip(items, known, strict=True)
            if result is None
        ]
        parts = in_parts(calls, len(calls), self.jobs)
        results: list[Any] = []
        parallel = Parallel(n_jobs=min(self.jobs, len(parts)) or 1, return_as="generator")
        with progress_bar(self.console) as bar:
            task = bar.add_task(what, total=len(items), completed=len(items) - len(calls))
            with without_interrupts():
                running = parallel(delayed(_work)(self.config, self.spec, part) for part in parts)
            for done in running:
                results += done
                bar.advance(task, len(done))
        new = iter(results)
        return [next(new) if result is None else result for result in known]


def in_parts(items: list[Item], work: int, jobs: int) -> list[list[Item]]:
    """Items of one call: of so much work enough to pay for the building, few enough to share."""
    size = max(1, min(CHUNK, work // (2 * jobs)))
    return [items[start : start + size] for start in range(0, len(items), size)]


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
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, before)


def _work(config: RunConfig, spec: AgentSpec, calls: Sequence[Any]) -> list[Any]:
    """In a process of its own: build, work, leave."""
    results = []
    with one_thread(), closing(Rig.build(config, spec)) as rig:
        for work, item, kept in calls:
            results.append(work(rig, item))
            if kept is not None:
                store, what, name = kept
                with suppress(OSError):  # a convenience: the folder may be another user's
                    store.put(what, name, results[-1])
    return results
