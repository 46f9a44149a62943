"""One evaluation: everything that is driven for it, in several processes, and its report."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from irl_dal.cli.threads import one_thread
from irl_dal.config import RunConfig, to_mapping
from irl_dal.evaluation.metrics import Measurements, Value, compute_metrics
from irl_dal.evaluation.rig import AgentSpec, PathItem, Rig
from irl_dal.evaluation.rollout import spread_steps
from irl_dal.evaluation.workers import Workers
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.result_store import ResultStore, result_key
from irl_dal.storage.run_folder import provenance

__all__ = ["PATH_DURATION", "Evaluation", "evaluate"]

PATH_DURATION = 5.0
"""Length of the paths that ADE and FDE compare [s]: five times the planned horizon, long enough for
a bend or a manoeuvre. The paper names none."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """An evaluation's result.

    Attributes:
        measurements: What was measured.
        report: The numbers, flat, ready for JSON.
    """

    measurements: Measurements
    report: dict[str, Value]


def evaluate(
    config: RunConfig, spec: AgentSpec, runs: Path, console: Console | None = None
) -> Evaluation:
    """Drive and measure.

    What is driven is kept until the evaluation is complete: the same one, interrupted and begun
    again, goes on. The returns of expert and random actions are kept for good, beside the runs.

    Args:
        config: What is evaluated; its `evaluation` says how much.
        spec: Who drives.
        runs: Folder that remembers the references' returns.
        console: Where the progress bar goes.

    Raises:
        CheckpointError: The run has no checkpoint that can be used.
        KeyboardInterrupt: With words on what is kept.
    """
    with one_thread():
        Rig.build(config, spec).close()  # what cannot be built says so here, once
    kept = _unfinished(config, spec, runs)
    try:
        with (
            kept.until_complete(),
            Workers(config, spec, config.evaluation.n_jobs, console) as workers,
        ):
            measurements = _measure(config, spec, workers, kept, _references(config, runs))
            rng = np.random.default_rng(config.evaluation.first_seed)
            numbers = compute_metrics(measurements, rng)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_what_is_kept(kept)) from None
    report: dict[str, Value] = {
        "policy": spec.policy,
        "variant": config.variant,
        "training_seed": config.seed if spec.policy == "run" else None,
    }
    report |= provenance(config) | numbers
    report |= {"latency_threads": 1, "latency_processes": config.evaluation.n_jobs}
    return Evaluation(measurements, report)


def _measure(
    config: RunConfig, spec: AgentSpec, workers: Workers, kept: ResultStore, references: ResultStore
) -> Measurements:
    """Drive whatever is not known yet."""
    extent = config.evaluation
    seeds = list(range(extent.first_seed, extent.first_seed + extent.episodes))
    held_out = seeds[: extent.held_out_episodes]
    episodes = workers.map_kept("driving", Rig.episode, seeds, kept)
    probes = workers.map_kept("expert", Rig.expert, held_out, kept)
    known = {("expert", probe["seed"]): probe["return"] for probe in probes}
    if config.shield.enabled:  # then expert and random actions drove as their references do
        known |= {(spec.policy, episode["seed"]): episode["return"] for episode in episodes}
    returns = []
    for driver, work in (("random", Rig.random_return), ("expert", Rig.expert_return)):
        for seed in seeds:
            if (driver, seed) in known:
                with suppress(OSError):
                    references.put(f"{driver} return", seed, {"return": known[driver, seed]})
        unknown = [seed for seed in seeds if (driver, seed) not in known]
        driven = workers.map_kept(f"{driver} return", work, unknown, references)
        known |= {
            (driver, seed): entry["return"] for seed, entry in zip(unknown, driven, strict=True)
        }
        returns.append([known[driver, seed] for seed in seeds])
    paths = workers.map_kept(
        "paths", Rig.path, _paths(config, probes), kept, lambda item: f"{item.seed}-{item.step}"
    )
    return Measurements(
        episodes=episodes,
        references=np.transpose(returns).tolist(),
        cloning=[probe["cloning"] for probe in probes],
        distances=[path["distances"] for path in paths],
    )


def _paths(config: RunConfig, probes: list[dict[str, Any]]) -> list[PathItem]:
    """States along held-out expert episodes from which paths are compared."""
    extent = config.evaluation
    horizon = max(1, round(PATH_DURATION / config.limits.dt))
    rng = np.random.default_rng(extent.first_seed)
    lengths = [len(probe["pose"]) - 1 for probe in probes]
    steps = spread_steps(lengths, extent.path_states, horizon, rng)
    return [
        PathItem(probe["seed"], step, np.array(probe["pose"][step : step + 1 + horizon]))
        for probe, chosen in zip(probes, steps, strict=True)
        for step in chosen
    ]


def _unfinished(config: RunConfig, spec: AgentSpec, runs: Path) -> ResultStore:
    """Results of an evaluation that is not complete: in the run's folder, or beside the runs."""
    settings = to_mapping(config)
    del settings["evaluation"]  # how much is driven, by how many: what was driven is the same
    run_dir = spec.run_dir
    weights = None if run_dir is None else CheckpointStore(run_dir).load().folder
    key = result_key({"policy": spec.policy, **settings}, weights)
    return ResultStore((runs if run_dir is None else run_dir) / "unfinished" / key)


def _references(config: RunConfig, runs: Path) -> ResultStore:
    """Returns of expert and random actions, for all evaluations in the same city."""
    mapping = to_mapping(config)
    settings = {name: mapping[name] for name in ("env", "expert", "limits", "shield")}
    del settings["shield"]["enabled"]  # the references always drive under it
    return ResultStore(runs / "references" / result_key(settings))


def _what_is_kept(store: ResultStore) -> str:
    count = store.count()
    if count == 0:
        return "nothing is kept"
    return f"{count} results are kept in {store.folder}, the same command goes on from there"
