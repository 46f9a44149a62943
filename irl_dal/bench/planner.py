"""How long a plan takes, and where the time goes."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from irl_dal.bench.stopwatch import time_parts
from irl_dal.build import build_loop, build_planner, expert_supervision
from irl_dal.config import ConfigError, RunConfig
from irl_dal.evaluation.agents import ExpertAgent
from irl_dal.evaluation.rollout import drive_episode
from irl_dal.figures.table import terminal_table
from irl_dal.planner import DiffusionPlanner, PlanningContext, TotalEnergy
from irl_dal.planner.fast_denoiser import FastDenoiser
from irl_dal.planner.projection import PlanProjection
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.run_folder import open_run

SEED = 7  # of the city's episode and of the noise
LIMITS_MS = {"ddpm": 60.0, "ddim": 8.0}  # p99 of a plan with guidance, projection in every step
PARTS: dict[str, list[tuple[type, str]]] = {
    "network": [(FastDenoiser, "condition"), (FastDenoiser, "predict")],
    "energy": [(TotalEnergy, "__init__"), (TotalEnergy, "evaluate")],
    "projection": [(PlanProjection, name) for name in ("clean", "noisy", "finish")],
}
"""Methods that are timed."""


def planner_tables(run: Path | None, rounds: int, contexts: int) -> Iterator[Table | str]:
    """Everything that the benchmark prints, as soon as it is known."""
    config = RunConfig() if run is None else open_run("--run", run).config
    scenes = logged_contexts(config, contexts)
    planners = {
        sampler: make_planner(config, run, sampler=sampler, projection="x0", deadline=None)
        for sampler in LIMITS_MS
    }
    weights = "untrained weights" if run is None else f"weights of {run.name}"
    yield f"{len(scenes)} states of one drive of the expert, {weights}, one thread"
    yield _latency_table(planners, scenes, rounds)
    yield _shares_table({name: shares(one, scenes, rounds) for name, one in planners.items()})


def logged_contexts(config: RunConfig, count: int) -> list[PlanningContext]:
    """Contexts evenly spread over one drive of the expert."""
    contexts: list[PlanningContext] = []
    with closing(build_loop(config, expert_supervision(config))) as loop:
        drive_episode(loop, ExpertAgent(), SEED, lambda _, info: contexts.append(info["context"]))
    places = np.linspace(0, len(contexts) - 1, min(count, len(contexts))).astype(int)
    return [contexts[place] for place in places]


def make_planner(config: RunConfig, run: Path | None = None, **settings: Any) -> DiffusionPlanner:
    """A planner with a run's weights or untrained ones; a ConfigError if the run has none."""
    planner = build_planner(replace(config, planner=replace(config.planner, **settings)))
    if planner is None:
        raise ConfigError(f"--run = {str(run)!r}: was trained without a planner")
    if run is not None:
        state = CheckpointStore(run).load().state
        planner.load_state_dict(state["diffusion"]["network"])
    return planner


def time_plans(
    planners: Sequence[DiffusionPlanner], contexts: Sequence[PlanningContext], rounds: int
) -> NDArray[np.float64]:
    """Wall clock and processor time of every plan [ms], shape (planners, plans, 2).

    The planners take turns on every context, so that a busy machine slows all of them.
    """
    clocks = (time.perf_counter, time.process_time)
    for planner in planners:
        planner.plan(contexts[0])  # warms up
    taken = np.empty((len(planners), rounds * len(contexts), 2))
    for place, context in enumerate([*contexts] * rounds):
        for planner, durations in zip(planners, taken, strict=True):
            begun = [clock() for clock in clocks]
            planner.plan(context)
            durations[place] = [clock() - start for clock, start in zip(clocks, begun, strict=True)]
    return 1e3 * taken


def shares(
    planner: DiffusionPlanner, contexts: Sequence[PlanningContext], rounds: int
) -> dict[str, float]:
    """Processor time of a plan by its parts and the rest [ms]."""
    planner.plan(contexts[0])
    todo = [*contexts] * rounds
    spent = time_parts(PARTS, lambda: [planner.plan(context) for context in todo])
    return {name: 1e3 * seconds / len(todo) for name, seconds in spent.items()}


def _latency_table(
    planners: Mapping[str, DiffusionPlanner], contexts: Sequence[PlanningContext], rounds: int
) -> Table:
    rows = []
    times = time_plans(list(planners.values()), contexts, rounds)
    for (name, planner), durations in zip(planners.items(), times, strict=True):
        percentiles = np.percentile(durations, (50.0, 99.0), axis=0).T.ravel()
        steps = len(planner.config.make_sampler().transitions)
        cells = [f"{value:.2f}" for value in percentiles]
        rows.append([f"{name.upper()}-{steps}", *cells, f"{LIMITS_MS[name]:.0f}"])
    headings = ["sampler", "wall p50 [ms]", "p99", "processor p50 [ms]", "p99", "target p99"]
    return terminal_table("one plan with guidance and projection in every step", headings, rows)


def _shares_table(spent: Mapping[str, Mapping[str, float]]) -> Table:
    headings = [text for name in spent for text in (f"{name.upper()} [ms]", "share")]
    rows = []
    for part in (*PARTS, "rest"):
        cells = [f"{t[part]:.2f} {t[part] / sum(t.values()):.0%}".split() for t in spent.values()]
        rows.append([part, *chain.from_iterable(cells)])
    title = "where a plan spends its time (processor time)"
    return terminal_table(title, ["part", *headings], rows)
