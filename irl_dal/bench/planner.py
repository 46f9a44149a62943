"""How long a plan takes, beside a plain loop over `diffusers`, and where the time goes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from numpy.typing import NDArray
from rich.table import Table
from torch import Tensor

from irl_dal.bench.plain_loop import PlainLoop
from irl_dal.build import build_loop, build_planner, expert_supervision
from irl_dal.config import ConfigError, RunConfig
from irl_dal.planner import DiffusionPlanner, PlanningContext, TotalEnergy
from irl_dal.planner.fast_denoiser import FastDenoiser
from irl_dal.planner.projection import PlanProjection
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.run_folder import open_run

__all__ = [
    "LIMITS_MS",
    "Durations",
    "compare_loops",
    "denoiser_loss",
    "growth",
    "logged_contexts",
    "make_planner",
    "planner_tables",
    "shares",
    "time_plans",
]

Array = NDArray[np.float64]

SEED = 7
"""Of the city's episode and of the noise."""

LIMITS_MS = {"ddpm": 60.0, "ddim": 8.0}
"""Longest p99 of a plan with guidance and projection in every step [ms]."""

PARTS: dict[str, tuple[tuple[type, str], ...]] = {
    "network": ((FastDenoiser, "condition"), (FastDenoiser, "predict")),
    "energy": ((TotalEnergy, "__init__"), (TotalEnergy, "evaluate")),
    "projection": tuple((PlanProjection, name) for name in ("clean", "noisy", "finish")),
}
"""Methods that are timed; what is left is called the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class Durations:
    """Of calls that took turns.

    Attributes:
        wall: Wall clock of each [s].
        processor: Processor time of each [s]; what other processes do does not enter.
    """

    wall: Array
    processor: Array

    def percentile(self, percent: float) -> tuple[float, float]:
        """Wall clock and processor time [ms]."""
        wall, processor = (np.percentile(x, percent) for x in (self.wall, self.processor))
        return 1e3 * float(wall), 1e3 * float(processor)


def logged_contexts(config: RunConfig, count: int) -> list[PlanningContext]:
    """Contexts evenly spread over one drive of the expert."""
    loop = build_loop(config, expert_supervision(config))
    try:
        _, info = loop.reset(seed=SEED)
        contexts, over = [info["context"]], False
        while not over:
            _, _, terminated, truncated, info = loop.step_expert()
            contexts.append(info["context"])
            over = terminated or truncated
    finally:
        loop.close()
    places = np.linspace(0, len(contexts) - 1, min(count, len(contexts))).astype(int)
    return [contexts[place] for place in places]


def make_planner(config: RunConfig, run: Path | None = None, **settings: Any) -> DiffusionPlanner:
    """A planner with a run's weights or untrained ones.

    Args:
        config: Of the run, or a default one.
        run: Folder whose weights are taken.
        settings: Replace fields of the planner's configuration.
    """
    planner = build_planner(replace(config, planner=replace(config.planner, **settings)))
    if planner is None:
        raise ConfigError(f"run = {str(run)!r}: was trained without a planner")
    if run is not None:
        state = CheckpointStore(open_run("run", run).path).load().state
        planner.load_state_dict(state["diffusion"]["network"])
    return planner


def time_plans(
    plans: Sequence[Callable[[PlanningContext], Any]],
    contexts: Sequence[PlanningContext],
    rounds: int,
) -> list[Durations]:
    """Durations of each way to plan, which take turns on every context."""
    for plan in plans:
        plan(contexts[0])
    taken: list[list[tuple[float, float]]] = [[] for _ in plans]
    for _ in range(rounds):
        for context in contexts:
            for plan, record in zip(plans, taken, strict=True):
                begun = time.perf_counter(), time.process_time()
                plan(context)
                ended = time.perf_counter(), time.process_time()
                record.append((ended[0] - begun[0], ended[1] - begun[1]))
    return [Durations(*np.array(record).T) for record in taken]


def compare_loops(
    planner: DiffusionPlanner, contexts: Sequence[PlanningContext], rounds: int
) -> tuple[Durations, Durations]:
    """Our loop and a plain one with the same network, guidance and projection.

    Raises:
        ImportError: `diffusers` is not installed.
    """
    ours, plain = time_plans([planner.plan, PlainLoop(planner).plan], contexts, rounds)
    return ours, plain


def shares(
    planner: DiffusionPlanner, contexts: Sequence[PlanningContext], rounds: int
) -> dict[str, float]:
    """Milliseconds of a plan that go into network, energy, projection and the rest."""
    spent: dict[str, float] = dict.fromkeys(PARTS, 0.0)
    planner.plan(contexts[0])
    with _timed(spent):
        begun = time.process_time()
        for _ in range(rounds):
            for context in contexts:
                planner.plan(context)
        total = time.process_time() - begun
    spent["rest"] = total - sum(spent.values())
    return {name: 1e3 * seconds / (rounds * len(contexts)) for name, seconds in spent.items()}


def growth(
    config: RunConfig, run: Path | None, contexts: Sequence[PlanningContext], rounds: int
) -> dict[str, dict[int, float]]:
    """Median processor time of a plan [ms] over H, T and N, each alone."""
    sweeps: dict[str, tuple[str, tuple[int, ...], dict[str, Any]]] = {
        "H": ("horizon", (4, 8, 16, 32), {}),
        "T": ("diffusion_steps", (25, 50, 100, 200), {"sampler": "ddpm"}),
        "N": ("candidates", (1, 4, 16, 64), {}),
    }
    found: dict[str, dict[int, float]] = {}
    for name, (key, values, extra) in sweeps.items():
        planners = [make_planner(config, run, **{key: value, **extra}) for value in values]
        taken = time_plans([planner.plan for planner in planners], contexts, rounds)
        medians = [durations.percentile(50.0)[1] for durations in taken]
        found[name] = dict(zip(values, medians, strict=True))
    return found


def denoiser_loss(
    planner: DiffusionPlanner, contexts: Sequence[PlanningContext]
) -> tuple[float, float]:
    """What the compiled network loses against the torch one, at every diffusion step.

    Returns:
        Largest difference of the outputs in normalised actions, and largest output.
    """
    table = planner.config.make_sampler().transitions
    fast = FastDenoiser(planner.denoiser, table.k)
    rng = np.random.default_rng(SEED)
    worst = largest = 0.0
    for context in contexts:
        code = context.encode()[None]
        films = fast.condition(code)
        for index, k in enumerate(table.k):
            noisy = rng.normal(size=(1, planner.config.horizon, 2))
            with torch.no_grad():
                plain: Tensor = planner.denoiser(
                    torch.from_numpy(noisy).float(), torch.tensor([int(k)]), torch.from_numpy(code)
                )
            ours = fast.predict(noisy, films, index)
            worst = max(worst, float(np.abs(ours - plain.numpy()).max()))
            largest = max(largest, float(plain.abs().max()))
    return worst, largest


def planner_tables(run: Path | None, rounds: int, contexts: int = 60) -> Iterator[Table | str]:
    """Everything that the benchmark prints, as soon as it is known.

    Args:
        run: Folder whose configuration and weights are used; None for untrained weights.
        rounds: How often every context is planned from.
        contexts: How many.
    """
    config = RunConfig() if run is None else open_run("run", run).config
    scenes = logged_contexts(config, contexts)
    planners = {
        sampler: make_planner(config, run, sampler=sampler, projection="x0", deadline=None)
        for sampler in LIMITS_MS
    }
    weights = "untrained weights" if run is None else f"weights of {run.name}"
    yield f"{len(scenes)} states of one drive of the expert, {weights}, one thread"
    taken = time_plans([planner.plan for planner in planners.values()], scenes, rounds)
    yield _latency_table(dict(zip(planners, taken, strict=True)), planners)
    try:
        yield _loops_table(*compare_loops(planners["ddpm"], scenes[::3], rounds))
    except ImportError:
        yield "diffusers is not installed: pip install diffusers"
    yield _shares_table({name: shares(one, scenes, rounds) for name, one in planners.items()})
    yield _growth_table(growth(config, run, scenes[::6], rounds))
    worst, largest = denoiser_loss(planners["ddpm"], scenes[::6])
    yield (
        f"the compiled network differs from the torch one by at most {worst:.1e} in outputs of up "
        f"to {largest:.2f} (normalised actions)"
    )


def _latency_table(taken: dict[str, Durations], planners: dict[str, DiffusionPlanner]) -> Table:
    table = Table(title="one plan with guidance and projection in every step")
    for title in ("sampler", "wall p50 [ms]", "p99", "processor p50 [ms]", "p99", "wanted p99"):
        table.add_column(title, justify="left" if title == "sampler" else "right")
    for name, durations in taken.items():
        middle, tail = durations.percentile(50.0), durations.percentile(99.0)
        steps = len(planners[name].config.make_sampler().transitions)
        cells = (f"{value:.2f}" for value in (middle[0], tail[0], middle[1], tail[1]))
        table.add_row(f"{name.upper()}-{steps}", *cells, f"{LIMITS_MS[name]:.0f}")
    return table


def _loops_table(ours: Durations, plain: Durations) -> Table:
    table = Table(title="DDPM beside a plain loop over diffusers' DDPMScheduler")
    for title in ("loop", "processor p50 [ms]", "p99", "share of the plain loop"):
        table.add_column(title, justify="left" if title == "loop" else "right")
    for name, durations in (("plain", plain), ("ours", ours)):
        middle, tail = (durations.percentile(percent)[1] for percent in (50.0, 99.0))
        share = middle / plain.percentile(50.0)[1]
        table.add_row(name, f"{middle:.2f}", f"{tail:.2f}", f"{share:.2f}")
    return table


def _shares_table(found: dict[str, dict[str, float]]) -> Table:
    table = Table(title="where a plan spends its time (processor time)")
    table.add_column("part")
    for name in found:
        table.add_column(f"{name.upper()} [ms]", justify="right")
        table.add_column("share", justify="right")
    for part in (*PARTS, "rest"):
        cells = []
        for spent in found.values():
            cells += [f"{spent[part]:.2f}", f"{spent[part] / sum(spent.values()):.0%}"]
        table.add_row(part, *cells)
    return table


def _growth_table(found: dict[str, dict[int, float]]) -> Table:
    table = Table(title="median processor time over H, T (DDPM) and N, each alone")
    for name in found:
        table.add_column(name, justify="right")
        table.add_column("ms", justify="right")
    columns = [list(times.items()) for times in found.values()]
    for row in zip(*columns, strict=True):
        cells = []
        for value, duration in row:
            cells += [str(value), f"{duration:.2f}"]
        table.add_row(*cells)
    return table


@contextmanager
def _timed(spent: dict[str, float]) -> Iterator[None]:
    with ExitStack() as stack:
        for name, methods in PARTS.items():
            for owner, method in methods:
                watched = _stopwatch(getattr(owner, method), name, spent)
                stack.enter_context(patch.object(owner, method, watched))
        yield


def _stopwatch(call: Callable[..., Any], name: str, spent: dict[str, float]) -> Callable[..., Any]:
    def timed(*args: Any, **kwargs: Any) -> Any:
        begun = time.process_time()
        result = call(*args, **kwargs)
        spent[name] += time.process_time() - begun
        return result

    return timed
