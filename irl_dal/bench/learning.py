"""How long the gradient steps of a run take, on one thread and on two."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from irl_dal.build import build_drivers, build_planner
from irl_dal.config import RunConfig
from irl_dal.figures.table import terminal_table
from irl_dal.learning import Pipeline
from irl_dal.learning.collection.driver import demonstrations
from irl_dal.learning.learners import Learners
from irl_dal.shortcuts import keep_freed_memory

COUNTS = (1, 2)  # threads that are compared
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


def time_updates(learners: Learners, rounds: int, steps: int) -> dict[str, NDArray[np.float64]]:
    """Median time of a gradient step [s] of policy and planner over `COUNTS`, which take turns."""
    updates = {"behaviour cloning": learners.clone, "planner": learners.train_planner}
    taken = {name: np.empty((rounds + 1, len(COUNTS))) for name in updates}
    for place in range(rounds + 1):
        for name, update in updates.items():
            for column, count in enumerate(COUNTS):
                learners.threads = count
                begun = time.perf_counter()
                update(steps)
                taken[name][place, column] = (time.perf_counter() - begun) / steps
    return {name: np.median(times[1:], axis=0) for name, times in taken.items()}  # 0 warms up


def learning_tables(config: RunConfig, rounds: int) -> Iterator[Table]:
    """What the benchmark prints."""
    keep_freed_memory()
    with demonstrated(config, DEMONSTRATION) as learners:
        medians = time_updates(learners, rounds, STEPS)
    title = "one gradient step (median wall clock)"
    headings = [f"{count} thread{'s' * (count > 1)} [ms]" for count in COUNTS]
    rows = [
        [name, *(f"{1e3 * time:.1f}" for time in times), f"{times[-1] / times[0]:.2f}"]
        for name, times in medians.items()
    ]
    yield terminal_table(title, ["update", *headings, "ratio"], rows)
