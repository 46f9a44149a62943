"""What one process drives for a comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irl_dal.build import build_planner
from irl_dal.cli.threads import one_thread
from irl_dal.comparison.config import ComparisonConfig
from irl_dal.comparison.settings import Arm
from irl_dal.comparison.store import ComparisonStore
from irl_dal.config import RunConfig
from irl_dal.evaluation.agents import ExpertAgent
from irl_dal.evaluation.episode import Episode, LoggedPlan
from irl_dal.evaluation.metrics import episode_record, path_rows, plan_rows
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.rollout import compare_paths, drive_episode, spread_steps
from irl_dal.loop import Observation
from irl_dal.planner import DiffusionPlanner, PlanningContext
from irl_dal.storage.checkpoint import CheckpointStore

__all__ = [
    "Subject",
    "arm_bench",
    "arm_planner",
    "drive_arm",
    "plan_in_states",
    "plan_log",
    "risky_contexts",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Subject:
    """What is compared; small enough to be sent to another process.

    Attributes:
        config: Of the run.
        run_dir: Its folder.
        comparison: Extent.
        store: Where results go.
    """

    config: RunConfig
    run_dir: Path
    comparison: ComparisonConfig
    store: ComparisonStore


@contextmanager
def arm_bench(subject: Subject, arm: Arm, render_mode: str | None = None) -> Iterator[Rig]:
    """The run's policy under an arm's supervision, on one thread."""
    config = arm.configure(subject.config)
    with one_thread():
        bench = Rig.build(config, AgentSpec("run", subject.run_dir), render_mode)
        try:
            yield bench
        finally:
            bench.close()


def arm_planner(subject: Subject, arm: Arm, candidates: int | None = None) -> DiffusionPlanner:
    """The run's planner as an arm has it."""
    planner = build_planner(arm.configure(subject.config, candidates))
    assert planner is not None
    state = CheckpointStore(subject.run_dir).load().state
    planner.load_state_dict(state["diffusion"]["network"])
    return planner


def drive_arm(subject: Subject, arm: Arm, seeds: Sequence[int]) -> int:
    """Drive an arm's episodes and keep each as soon as it is over.

    Returns:
        How many were driven.
    """
    with arm_bench(subject, arm) as bench:
        for seed in seeds:
            episode = bench.drive(seed)
            distances = [
                compare_paths(bench.loop, bench.reference, bench.agent, seed, step, pose)
                for step, pose in _stretches(subject, seed)
            ]
            record = episode_record(episode, subject.config.limits)
            record["rows"] |= path_rows(distances)
            subject.store.keep_episode(arm.name, seed, record)
    return len(seeds)


def plan_in_states(subject: Subject, arms: Sequence[Arm], seeds: Sequence[int]) -> int:
    """Drive the expert, and let every arm plan in the same risky states with the same noise.

    Returns:
        How many episodes were driven.
    """
    with arm_bench(subject, arms[0]) as bench:
        planners = {
            arm.name: arm_planner(subject, arm, subject.comparison.candidates) for arm in arms
        }
        for seed in seeds:
            expert, contexts = risky_contexts(bench, seed)
            chosen = [contexts[step] for step in _spread(sorted(contexts), subject.comparison)]
            plans: dict[str, Any] = {}
            for name, planner in planners.items():
                log = plan_log(planner, chosen, seed)
                plans[name] = plan_rows(log, subject.config.limits, "state_") if chosen else {}
            subject.store.keep_states(
                seed,
                {
                    "seed": seed,
                    "steps": expert.steps,
                    "risky": len(contexts),
                    "pose": np.round(expert.pose, 6).tolist(),
                    "plans": plans,
                },
            )
    return len(seeds)


def risky_contexts(bench: Rig, seed: int) -> tuple[Episode, dict[int, PlanningContext]]:
    """The expert's episode, and the contexts of its risky states by step."""
    contexts: dict[int, PlanningContext] = {}
    step = 0

    def watch(_observation: Observation, info: Mapping[str, Any]) -> None:
        nonlocal step
        if info["risk"].risky:
            contexts[step] = info["context"]
        step += 1

    with bench.loop.under(bench.reference):
        episode = drive_episode(bench.loop, ExpertAgent(), seed, watch)
    contexts.pop(episode.steps, None)
    return episode, contexts


def plan_log(
    planner: DiffusionPlanner, contexts: Sequence[PlanningContext], seed: int
) -> list[LoggedPlan]:
    """Plans from contexts; the noise depends on the seed and on the context's place."""
    plans = []
    for place, context in enumerate(contexts):
        planner.reset()
        planner.generator.manual_seed(1000 * seed + place)
        plans.append(LoggedPlan(planner.plan(context), context.previous))
    return plans


def _spread(steps: Sequence[int], comparison: ComparisonConfig) -> list[int]:
    """At most `states` of the risky steps, evenly spread over them."""
    count = min(comparison.states, len(steps))
    return [steps[int(place)] for place in np.linspace(0, len(steps) - 1, count)] if count else []


def _stretches(subject: Subject, seed: int) -> Iterator[tuple[int, Array]]:
    """Where an arm's path is compared with the expert's, the same for every arm."""
    known = subject.store.states(seed)
    assert known is not None
    comparison = subject.comparison
    horizon = max(1, round(comparison.path_duration / subject.config.limits.dt))
    pose = np.array(known["pose"])
    rng = np.random.default_rng(seed)
    (steps,) = spread_steps([len(pose) - 1], comparison.path_states, horizon, rng)
    for step in steps:
        yield step, pose[step : step + 1 + horizon]


Work = Callable[[], int]
"""Something to do in another process; how many episodes it drove."""
