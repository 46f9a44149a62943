"""A comparison from beginning to end: drive what is missing, then put the numbers together.

<out>/driven/<key>/expert/<seed>.json              the expert's path
<out>/driven/<key>/planning/<setting>/<seed>.json  plans in its risky states
<out>/driven/<key>/driving/<setting>/<seed>.json   rows of every number of one episode
<out>/compare.json, index.html, figures/           written at the end

The key changes with all that an episode's numbers depend on, so an interrupted comparison goes on
and a larger one drives only what it adds.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from joblib import Parallel, delayed
from rich.console import Console

from irl_dal.cli.overrides import require_writable
from irl_dal.comparison.config import all_settings, planning_settings
from irl_dal.comparison.drive import PATH_STATES, ComparisonJob, drive_setting, setting_rig
from irl_dal.comparison.planning import STATES, plan_in_states
from irl_dal.comparison.summary import summarise
from irl_dal.config import ConfigError, to_mapping
from irl_dal.evaluation.suite import PATH_DURATION
from irl_dal.evaluation.workers import in_parts, progress_bar
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.result_store import ResultStore, result_key
from irl_dal.storage.run_folder import provenance

GROUPS = ("env", "expert", "limits", "shield", "planner", "perception")
"""Groups of a run's configuration that its drives depend on."""


def compare(job: ComparisonJob, console: Console | None = None) -> dict[str, Any]:
    """Drive every setting on every seed that is not known yet, and summarise all of it for JSON.

    Raises:
        CheckpointError: The run has no checkpoint that can be used.
        ConfigError: The folder of results holds something else or cannot be written.
    """
    comparison, jobs = job.comparison, job.comparison.n_jobs
    settings = all_settings(comparison, job.config.planner.projection)
    planning = planning_settings(comparison, job.config.planner.projection)
    with setting_rig(job, settings[0]):
        pass  # what cannot be built says so here, once
    _claim(job)
    store = result_store(job)
    seeds = list(comparison.seeds)
    kinds = ["expert", *(f"planning/{setting.plan_label}" for setting in planning)]
    missing = _missing(store, seeds, kinds)
    states = [(plan_in_states, planning, part) for part in in_parts(missing, len(missing), jobs)]
    drives = [  # the first seeds of all settings before the next ones
        (drive_setting, setting, part)
        for seeds_of_all in in_parts(seeds, len(seeds) * len(settings), jobs)
        for setting in settings
        if (part := _missing(store, seeds_of_all, [f"driving/{setting.name}"]))
    ]
    _work(job, store, "expert's states", states, console)
    _work(job, store, "driving", drives, console)
    return {
        "variant": job.config.variant,
        "training_seed": job.config.seed,
        **provenance(job.config),
        "settings": asdict(comparison) | _constants(),
        "sampler": job.config.planner.sampler,
        "default_projection": job.config.planner.projection,
        **summarise(store, settings, planning, seeds),
    }


def result_store(job: ComparisonJob) -> ResultStore:
    """Where the job's episodes are kept."""
    config = to_mapping(job.config)
    key = result_key(
        {group: config[group] for group in GROUPS}
        | {"candidates": job.comparison.candidates}
        | _constants(),
        CheckpointStore(job.run_dir).load().folder,
    )
    return ResultStore(job.out / "driven" / key)


def _constants() -> dict[str, float]:
    """The part of the extent that is not configured."""
    return {"states": STATES, "path_states": PATH_STATES, "path_duration": PATH_DURATION}


def _claim(job: ComparisonJob) -> None:
    """Make the folder of the results; a folder of something else is left alone."""
    ours = (job.out / "driven").is_dir() or job.results.is_file()
    if job.out.is_dir() and not ours and any(job.out.iterdir()):
        raise ConfigError(f"out = {str(job.out)!r}: not empty and not the folder of a comparison")
    require_writable("out", job.out, folder=True)


def _missing(store: ResultStore, seeds: Sequence[int], kinds: Sequence[str]) -> list[int]:
    """Seeds of which not every kind of result is kept."""
    return [seed for seed in seeds if any(store.get(kind, seed) is None for kind in kinds)]


def _work(
    job: ComparisonJob,
    store: ResultStore,
    what: str,
    calls: Sequence[tuple[Callable[..., int], Any, Sequence[int]]],
    console: Console | None,
) -> None:
    if not calls:
        return
    with progress_bar(console) as progress:
        task = progress.add_task(what, total=sum(len(seeds) for _, _, seeds in calls))
        jobs = min(job.comparison.n_jobs, len(calls))
        parallel = Parallel(n_jobs=jobs, return_as="generator_unordered")
        for done in parallel(delayed(work)(job, store, who, seeds) for work, who, seeds in calls):
            progress.advance(task, done)
