"""How long the gradient steps of a run take, on one thread and on two, alone and not alone."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.table import Table

from irl_dal.build import build_drivers, build_planner
from irl_dal.config import RunConfig
from irl_dal.figures.table import terminal_table
from irl_dal.learning import Pipeline
from irl_dal.learning.collection.driver import demonstrations
from irl_dal.learning.learners import Learners
from irl_dal.shortcuts import keep_freed_memory

COUNTS = (1, 2)  # threads that are compared
BUSY = (0, 1, 2)  # other processes beside which they are compared
STEPS = 10  # gradient steps of one timed update
DEMONSTRATION = 400  # steps of the expert that the updates learn from


@contextmanager
def demonstrated(config: RunConfig, steps: int) -> Iterator[Learners]:
    """The learners of a new run after some steps of the expert."""
    drivers = build_drivers(config, processes=False)
    with TemporaryDirectory() as folder:
        planner, seen, seed = build_planner(config), config.perception, config.seed
        pipeline = Pipeline(
            config.learning, drivers, planner, perception=seen, run_dir=Path(folder), seed=seed
        )
        pipeline.learners.ppo.set_logger(pipeline.log.open(0))
        try:
            for record in demonstrations(pipeline.cars, steps):
                pipeline.recorder.take(record)
            yield pipeline.learners
        finally:
            pipeline.log.close()
            drivers.close()


def time_updates(learners: Learners, rounds: int, steps: int) -> dict[str, dict[int, float]]:
    """Median time of a gradient step [s] of policy and planner over threads, which take turns."""
    updates = {"behaviour cloning": learners.clone, "planner": learners.train_planner}
    taken: dict[str, dict[int, list[float]]] = {
        name: {count: [] for count in COUNTS} for name in updates
    }
    for place in range(-1, rounds):
        for name, update in updates.items():
            for count in COUNTS:
                learners.threads = count
                begun = time.perf_counter()
                update(steps)
                if place >= 0:  # the first round warms up
                    taken[name][count].append((time.perf_counter() - begun) / steps)
    return {
        name: {count: float(np.median(times)) for count, times in columns.items()}
        for name, columns in taken.items()
    }


@contextmanager
def beside(processes: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """So many other processes compute meanwhile."""
    others = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)
    ]
    try:
        yield others
    finally:
        for other in others:
            other.kill()
            other.wait()


def learning_tables(config: RunConfig, rounds: int) -> Iterator[Table]:
    """What the benchmark prints, for each number of other processes as soon as it is known."""
    keep_freed_memory()
    with demonstrated(config, DEMONSTRATION) as learners:
        for processes in BUSY:
            with beside(processes):
                yield _table(time_updates(learners, rounds, STEPS), processes)


def _table(medians: dict[str, dict[int, float]], processes: int) -> Table:
    title = f"one gradient step beside {processes} busy processes (median wall clock)"
    headings = [f"{count} thread{'s' * (count > 1)} [ms]" for count in COUNTS]
    rows = []
    for name, times in medians.items():
        cells = [f"{1e3 * times[count]:.1f}" for count in COUNTS]
        rows.append([name, *cells, f"{times[COUNTS[-1]] / times[COUNTS[0]]:.2f}"])
    return terminal_table(title, ["update", *headings, "ratio"], rows)
