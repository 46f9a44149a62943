"""A comparison from beginning to end: drive what is missing, then put the numbers together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import Progress

from irl_dal.comparison.drive import Subject, Work, arm_bench, drive_arm, plan_in_states
from irl_dal.comparison.numbers import summarise
from irl_dal.comparison.settings import Arm, arms_of, state_arms
from irl_dal.config import to_mapping
from irl_dal.evaluation.workers import CHUNK, progress_bar
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.fingerprint import code_fingerprint, fingerprint
from irl_dal.storage.run_folder import provenance

__all__ = ["compare", "settings_of"]


def compare(subject: Subject, console: Console | None = None) -> dict[str, Any]:
    """Drive every arm on every seed that is not known yet, and summarise all of it.

    Args:
        subject: What is compared.
        console: Where the progress bar goes.

    Returns:
        The report, ready for JSON.

    Raises:
        CheckpointError: The run has no checkpoint that can be used.
        ConfigError: The folder of results belongs to something else.
    """
    comparison, store = subject.comparison, subject.store
    arms = arms_of(comparison, subject.config.planner.projection)
    planning = state_arms(comparison, subject.config.planner.projection)
    with arm_bench(subject, arms[0]):
        pass  # what cannot be built says so here, once
    store.open(settings_of(subject))
    seeds = list(comparison.seeds)
    missing = store.missing_states(seeds, [arm.name for arm in planning])
    states = [delayed(plan_in_states)(subject, planning, part) for part in _parts(missing, subject)]
    driven = _interleaved(subject, arms, seeds)
    with progress_bar(console) as progress:
        _run(states, "expert's states", len(missing), comparison.n_jobs, progress)
        calls = [delayed(drive_arm)(subject, arm, part) for arm, part in driven]
        total = sum(len(part) for _, part in driven)
        _run(calls, "driving", total, comparison.n_jobs, progress)
    return {
        "variant": subject.config.variant,
        "training_seed": subject.config.seed,
        **provenance(subject.config),
        "settings": asdict(comparison),
        "sampler": subject.config.planner.sampler,
        "default_projection": subject.config.planner.projection,
        **summarise(store, arms, planning, seeds),
    }


def settings_of(subject: Subject) -> dict[str, Any]:
    """All that one episode's numbers depend on."""
    checkpoint = CheckpointStore(subject.run_dir).load()
    comparison = subject.comparison
    config = to_mapping(subject.config)
    kept = ("env", "expert", "shield", "planner", "perception")
    return {
        "run": subject.run_dir.name,
        "step": checkpoint.step,
        "weights": fingerprint(*sorted(checkpoint.folder.iterdir())),
        "first_seed": comparison.first_seed,
        "states": comparison.states,
        "candidates": comparison.candidates,
        "path_states": comparison.path_states,
        "path_duration": comparison.path_duration,
        "code": code_fingerprint(),
        **{f"config.{key}": config[key] for key in kept},
    }


def _interleaved(
    subject: Subject, arms: Sequence[Arm], seeds: Sequence[int]
) -> list[tuple[Arm, list[int]]]:
    """What is missing, the first seeds of all arms before the next ones."""
    size = _size(len(seeds) * len(arms), subject)
    driven = []
    for start in range(0, len(seeds), size):
        for arm in arms:
            part = subject.store.missing_episodes(arm.name, seeds[start : start + size])
            if part:
                driven.append((arm, part))
    return driven


def _parts(seeds: Sequence[int], subject: Subject) -> list[Sequence[int]]:
    size = _size(len(seeds), subject)
    return [seeds[start : start + size] for start in range(0, len(seeds), size)]


def _size(items: int, subject: Subject) -> int:
    """Episodes of one call: many enough to make building worth while, few enough to share out."""
    return max(1, min(CHUNK, items // (2 * subject.comparison.n_jobs)))


def _run(
    calls: Sequence[tuple[Work, Any, Any]], what: str, total: int, jobs: int, progress: Progress
) -> None:
    if not calls:
        return
    task = progress.add_task(what, total=total)
    parallel = Parallel(n_jobs=min(jobs, len(calls)), return_as="generator_unordered")
    for done in parallel(calls):
        progress.advance(task, done)
