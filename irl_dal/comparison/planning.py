"""Plans of every setting in the same states: the risky ones of the expert's drives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irl_dal.build import build_planner
from irl_dal.comparison.config import Setting
from irl_dal.comparison.drive import ComparisonJob, setting_rig
from irl_dal.evaluation.agents import ExpertAgent
from irl_dal.evaluation.episode import Episode, LoggedPlan
from irl_dal.evaluation.metrics import plan_rows
from irl_dal.evaluation.rig import Rig
from irl_dal.evaluation.rollout import drive_episode
from irl_dal.evaluation.statistics import Array
from irl_dal.planner import DiffusionPlanner, Plan, PlanningContext, Refinement
from irl_dal.planner.projection import defect
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.result_store import ResultStore

STATES = 10  # risky states per episode in which every setting plans


def setting_planner(job: ComparisonJob, setting: Setting) -> DiffusionPlanner:
    """The run's planner in a setting, with the comparison's number of candidates."""
    planner = build_planner(setting.configure(job.config, job.comparison.candidates))
    assert planner is not None
    state = CheckpointStore(job.run_dir).load().state
    planner.load_state_dict(state["diffusion"]["network"])
    return planner


def plan_in_states(
    job: ComparisonJob, store: ResultStore, settings: Sequence[Setting], seeds: Sequence[int]
) -> int:
    """Plan in the expert's risky states in every setting with the same noise; counts the seeds."""
    planners = {setting: setting_planner(job, setting) for setting in settings}
    with setting_rig(job, settings[0]) as rig:
        for seed in seeds:
            expert, contexts = risky_contexts(rig, seed)
            places = np.linspace(0, len(contexts) - 1, min(STATES, len(contexts))).astype(int)
            chosen = [contexts[place] for place in places]
            for setting, planner in planners.items():
                log = plan_log(planner, chosen, seed)
                rows = plan_rows(log, job.config.limits, "state_") if chosen else {}
                store.put(f"planning/{setting.plan_label}", seed, {"rows": rows})
            store.put("expert", seed, {"pose": np.round(expert.pose, 6).tolist()})
    return len(seeds)


def risky_contexts(rig: Rig, seed: int) -> tuple[Episode, list[PlanningContext]]:
    """The expert's episode, and the contexts of its risky states in their order."""
    infos: list[Mapping[str, Any]] = []
    with rig.loop.under(rig.reference):
        episode = drive_episode(rig.loop, ExpertAgent(), seed, lambda _, info: infos.append(info))
    steps = pairwise(infos)  # what was asked for in a state is judged in the step that follows
    return episode, [before["context"] for before, after in steps if after["risk"].risky]


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


class _Watcher(Refinement):
    """Remembers every clean estimate (B, H, 2) as the loop goes on with it."""

    def __init__(self) -> None:
        self.seen: list[Array] = []

    def clean(self, clean: Array, index: int) -> Array:
        self.seen.append(clean.copy())
        return clean


@dataclass(frozen=True, slots=True, eq=False)
class DenoisingTrace:
    """The clean estimates of one call of the planner."""

    label: str  # name of the projection mode
    k: NDArray[np.int64]  # diffusion step that each estimate belongs to (S,)
    estimates: Array  # (S, N, H, 2) [rad, m/s]
    plan: Plan  # what came out


def most_violating_state(job: ComparisonJob, setting: Setting) -> tuple[int, PlanningContext]:
    """Seed and risky state of the first seeds in which pure diffusion errs most.

    Where the expert met no risk, its first state.
    """
    planner = setting_planner(job, setting)
    states: list[tuple[float, int, PlanningContext]] = []
    with setting_rig(job, setting) as rig:
        for seed in job.comparison.seeds[:3]:
            _, contexts = risky_contexts(rig, seed)
            for context in contexts[:: max(1, len(contexts) // 8)]:
                planner.generator.manual_seed(seed)
                plan = planner.plan(context)
                worst = defect(plan.candidates, context.previous, planner.limits)
                states.append((float(np.median(worst)), seed, context))
        if not states:
            seed = job.comparison.first_seed
            states.append((0.0, seed, rig.loop.reset(seed=seed)[1]["context"]))
    return max(states, key=lambda entry: entry[0])[1:]


def trace_plan(
    job: ComparisonJob, setting: Setting, context: PlanningContext, seed: int
) -> DenoisingTrace:
    """Plan once and watch; the noise depends on the seed alone."""
    planner = setting_planner(job, setting)
    planner.generator.manual_seed(seed)
    watcher = _Watcher()
    plan = planner.plan(context, [watcher])
    estimates = [planner.limits.to_command(clean) for clean in watcher.seen]
    return DenoisingTrace(
        label=setting.projection,
        k=planner.config.make_sampler().transitions.k[: len(estimates)],
        estimates=np.array(estimates).reshape(-1, *plan.candidates.shape),
        plan=plan,
    )
