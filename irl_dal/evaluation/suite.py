"""One evaluation: everything that is driven for it, in several processes, and its report."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from irl_dal.cli.threads import one_thread
from irl_dal.config import RunConfig, to_mapping
from irl_dal.evaluation.measurements import (
    HeldOutActions,
    Measurements,
    PathPair,
    ReferenceReturns,
)
from irl_dal.evaluation.metrics import Value, compute_metrics
from irl_dal.evaluation.references import ReferenceCache
from irl_dal.evaluation.rig import AgentSpec, Bench
from irl_dal.evaluation.rollout import spread_steps
from irl_dal.evaluation.workers import Workers
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.fingerprint import code_fingerprint, fingerprint
from irl_dal.storage.run_folder import RunFolder, provenance

__all__ = ["Evaluation", "evaluate"]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """An evaluation's result.

    Attributes:
        measurements: What was logged.
        report: The numbers, flat, ready for JSON.
    """

    measurements: Measurements
    report: dict[str, Value]


def evaluate(
    config: RunConfig, spec: AgentSpec, runs: Path, console: Console | None = None
) -> Evaluation:
    """Drive and measure.

    What a run has driven is kept in its folder until the end: the same evaluation, interrupted and
    begun again, goes on.

    Args:
        config: What is evaluated; its `evaluation` says how much.
        spec: Who drives.
        runs: Folder that remembers the references' returns.
        console: Where the progress bar goes.

    Raises:
        CheckpointError: The run has no checkpoint that can be used.
    """
    with one_thread():
        Bench.build(config, spec).close()  # what cannot be built says so here, once
    kept = _unfinished(config, spec)
    with Workers(config, spec, config.evaluation.n_jobs, console, kept) as workers:
        measurements = _measure(config, spec, runs, workers)
    rng = np.random.default_rng(config.evaluation.first_seed)
    report: dict[str, Value] = {
        "policy": spec.policy,
        "variant": config.variant,
        "training_seed": config.seed if spec.policy == "run" else None,
    }
    report |= provenance(config)
    report |= compute_metrics(measurements, config.limits, rng)
    report |= {"latency_threads": 1, "latency_processes": config.evaluation.n_jobs}
    if kept is not None:
        shutil.rmtree(kept.parent, ignore_errors=True)
    return Evaluation(measurements, report)


def _measure(config: RunConfig, spec: AgentSpec, runs: Path, workers: Workers) -> Measurements:
    """Drive whatever is not known yet."""
    extent = config.evaluation
    seeds = list(range(extent.first_seed, extent.first_seed + extent.episodes))
    cache = ReferenceCache.beside(runs, _city_hash(config))
    episodes = workers.map("driving", Bench.drive, seeds)
    if spec.policy != "run" and config.shield.enabled:
        cache.add(spec.policy, {episode.seed: episode.total_reward for episode in episodes})
    held_out = seeds[: extent.held_out_episodes]
    # Others may write the file meanwhile: what is used is what was read here or driven here.
    expert_returns, random_returns = cache.known("expert"), cache.known("random")
    also = [seed for seed in seeds if seed not in expert_returns and seed not in held_out]
    probes = workers.map("expert", Bench.probe, held_out + also)
    driven = {episode.seed: episode.total_reward for episode, _ in probes}
    cache.add("expert", driven)
    expert_returns |= driven
    unknown = [seed for seed in seeds if seed not in random_returns]
    driven = dict(zip(unknown, workers.map("random", Bench.random_return, unknown), strict=True))
    cache.add("random", driven)
    random_returns |= driven
    return Measurements(
        episodes=episodes,
        references=ReferenceReturns(
            expert=np.array([expert_returns[seed] for seed in seeds]),
            random=np.array([random_returns[seed] for seed in seeds]),
        ),
        held_out=_join([answers for _, answers in probes[: len(held_out)]]),
        pairs=_pairs(config, [episode for episode, _ in probes[: len(held_out)]], workers),
    )


def _pairs(config: RunConfig, experts: Sequence[Any], workers: Workers) -> list[PathPair]:
    """Compare paths from states along held-out expert episodes."""
    extent = config.evaluation
    horizon = max(1, round(extent.path_duration / config.limits.dt))
    rng = np.random.default_rng(extent.first_seed)
    lengths = [episode.steps for episode in experts]
    steps = spread_steps(lengths, extent.path_states, horizon, rng)
    stretches = [
        (episode, [step], horizon)
        for episode, chosen in zip(experts, steps, strict=True)
        for step in chosen
    ]
    found = workers.map("paths", Bench.compare, stretches)
    return [pair for pairs in found for pair in pairs]


def _join(answers: Sequence[HeldOutActions]) -> HeldOutActions | None:
    if not answers:
        return None
    return HeldOutActions(
        seed=np.concatenate([part.seed for part in answers]),
        mode=np.concatenate([part.mode for part in answers]),
        agent_action=np.concatenate([part.agent_action for part in answers]),
        expert_action=np.concatenate([part.expert_action for part in answers]),
    )


def _city_hash(config: RunConfig) -> str:
    """Hash of what the references' returns depend on: city, expert, bounds, and their code."""
    parts = [asdict(config.env), asdict(config.expert), asdict(config.limits)]
    text = json.dumps(parts, sort_keys=True)
    return fingerprint(text, code_fingerprint())


def _unfinished(config: RunConfig, spec: AgentSpec) -> Path | None:
    """Where a run's evaluation keeps what it has driven: by weights, settings and code."""
    if spec.run_dir is None:
        return None
    settings = to_mapping(config)
    del settings["evaluation"]  # how much is driven, by how many: what was driven is the same
    weights = sorted(CheckpointStore(spec.run_dir).load().folder.iterdir())
    name = fingerprint(json.dumps(settings, sort_keys=True), *weights, code_fingerprint())
    return RunFolder(spec.run_dir, config).unfinished / name
