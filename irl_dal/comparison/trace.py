"""One plan while it is denoised, for the page's figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from irl_dal.comparison.drive import Subject, arm_bench, arm_planner, risky_contexts
from irl_dal.comparison.settings import Arm
from irl_dal.planner import Plan, PlanningContext, Refinement
from irl_dal.planner.projection import defect

__all__ = ["DenoisingTrace", "telling_context", "trace_plan"]

Array = NDArray[np.float64]


@dataclass(slots=True)
class _Watcher(Refinement):
    """Remembers every clean estimate as the loop goes on with it."""

    seen: list[Array] = field(default_factory=list)

    def clean(self, clean: Array, index: int) -> Array:
        """Remember it (B, H, 2)."""
        self.seen.append(clean.copy())
        return clean


@dataclass(frozen=True, slots=True, eq=False)
class DenoisingTrace:
    """The clean estimates of one call of the planner.

    Attributes:
        label: Name of the mode.
        k: Diffusion step that each estimate belongs to (S,).
        estimates: (S, N, H, 2) [rad, m/s].
        plan: What came out.
    """

    label: str
    k: NDArray[np.int64]
    estimates: Array
    plan: Plan


def telling_context(subject: Subject, arms: Sequence[Arm]) -> tuple[int, PlanningContext]:
    """The risky state of the comparison's first seeds in which pure diffusion errs most.

    Args:
        subject: What is compared.
        arms: Its first one gives the planner.

    Returns:
        The seed and the state; where the expert met no risk, its first state's own.
    """
    planner = arm_planner(subject, arms[0], subject.comparison.candidates)
    found: list[tuple[float, int, PlanningContext]] = []
    with arm_bench(subject, arms[0]) as bench:
        for seed in subject.comparison.seeds[:3]:
            _, contexts = risky_contexts(bench, seed)
            places = sorted(contexts)[:: max(1, len(contexts) // 8)]
            for context in (contexts[place] for place in places):
                planner.generator.manual_seed(seed)
                plan = planner.plan(context)
                worst = defect(plan.candidates, context.previous, planner.limits)
                found.append((float(np.median(worst)), seed, context))
        if not found:
            seed = subject.comparison.seeds[0]
            found.append((0.0, seed, bench.loop.reset(seed=seed)[1]["context"]))
    _, seed, context = max(found, key=lambda entry: entry[0])
    return seed, context


def trace_plan(subject: Subject, arm: Arm, context: PlanningContext, seed: int) -> DenoisingTrace:
    """Plan once and watch; the noise depends on the seed alone."""
    planner = arm_planner(subject, arm, subject.comparison.candidates)
    planner.generator.manual_seed(seed)
    watcher = _Watcher()
    plan = planner.plan(context, [watcher])
    config = planner.config
    estimates = [planner.limits.to_command(clean) for clean in watcher.seen]
    return DenoisingTrace(
        label=arm.projection,
        k=config.make_sampler().transitions.k[: len(estimates)],
        estimates=np.array(estimates).reshape(-1, *plan.candidates.shape),
        plan=plan,
    )
