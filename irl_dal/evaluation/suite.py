"""One evaluation: everything that is driven for it, in several processes, and its report."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from irl_dal.cli.threads import one_thread
from irl_dal.config import RunConfig, to_mapping
from irl_dal.evaluation.metrics import Value, compute_metrics
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.rollout import stretches
from irl_dal.evaluation.workers import Workers
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.result_store import ResultStore, result_key
from irl_dal.storage.run_folder import provenance

PATH_DURATION = 5.0
"""Length of the paths that ADE and FDE compare [s]: six planned horizons, long enough for a bend
or a manoeuvre. The paper names none."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """`episode_record` of each of the agent's episodes, and the numbers, flat, ready for JSON."""

    episodes: list[dict[str, Any]]
    report: dict[str, Value]


def evaluate(
    config: RunConfig, spec: AgentSpec, runs: Path, console: Console | None = None
) -> Evaluation:
    """Drive and measure.

    What is driven is kept until the evaluation is complete: the same one, interrupted and begun
    again, goes on. The returns of expert and random actions are kept for good, in the folder
    `runs`.

    Raises:
        CheckpointError: The run has no checkpoint that can be used.
        KeyboardInterrupt: With words on what is kept.
    """
    with one_thread():
        Rig.build(config, spec).close()  # what cannot be built says so here, once
    kept, jobs = _unfinished(config, spec, runs), config.evaluation.n_jobs
    head = {
        "policy": spec.policy,
        "variant": config.variant,
        "training_seed": config.seed if spec.policy == "run" else None,
        **provenance(config),
    }
    try:
        with kept.until_complete():
            workers = Workers(config, spec, jobs, console)
            episodes, report = _measure(config, spec, workers, kept, _references(config, runs))
    except KeyboardInterrupt:
        count = kept.count()
        where = f"{count} results are kept in {kept.folder}, the same command goes on from there"
        raise KeyboardInterrupt(where if count else "nothing is kept") from None
    return Evaluation(episodes, head | report | {"latency_threads": 1, "latency_processes": jobs})


def _measure(
    config: RunConfig, spec: AgentSpec, workers: Workers, kept: ResultStore, references: ResultStore
) -> tuple[list[dict[str, Any]], dict[str, Value]]:
    """Drive whatever is not known yet."""
    extent = config.evaluation
    seeds = list(range(extent.first_seed, extent.first_seed + extent.episodes))
    episodes = workers.map("driving", Rig.episode, seeds, kept)
    probes = workers.map("expert", Rig.expert, seeds[: extent.held_out_episodes], kept)
    known = [("expert", probe) for probe in probes]
    if config.shield.enabled:  # then expert and random actions drove as their references do
        known += [(spec.policy, episode) for episode in episodes]
    for driver, entry in known:
        with suppress(OSError):
            references.put(f"{driver} return", entry["seed"], {"return": entry["return"]})
    returns = [
        [entry["return"] for entry in workers.map(f"{driver} return", work, seeds, references)]
        for driver, work in (("random", Rig.random_return), ("expert", Rig.expert_return))
    ]
    horizon = max(1, round(PATH_DURATION / config.limits.dt))
    starts = np.random.default_rng(extent.first_seed)
    drives = {probe["seed"]: np.array(probe["pose"]) for probe in probes}
    parts = stretches(drives, extent.path_states, horizon, starts)
    paths = workers.map("paths", Rig.path, parts, kept, lambda item: f"{item[0]}-{item[1]}")
    report = compute_metrics(
        episodes,
        np.random.default_rng(extent.first_seed),
        references=list(zip(*returns, strict=True)),
        cloning=[probe["cloning"] for probe in probes],
        distances=[path["distances"] for path in paths],
    )
    return episodes, report


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
