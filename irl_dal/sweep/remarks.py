"""What the runs show, in sentences made of their numbers."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from irl_dal.evaluation.statistics import Estimate
from irl_dal.sweep.collection import ORDER, Collection
from irl_dal.sweep.paper_table import Estimates, label
from irl_dal.sweep.result import RunResult


def remarks(collection: Collection, estimates: Estimates) -> list[str]:
    """The order of the variants, and how interventions went."""
    sentences = [
        _order(estimates, "success", "success", 1.0),
        _order(estimates, "collisions_per_1k_steps", "collisions", -1.0),
    ]
    for variant in collection.variants:
        shares = interventions(collection.of(variant))
        if shares is not None and shares[0] > 0.0:
            early, late = shares
            way = "fall" if late < early else "do not fall"
            sentences.append(
                f"{label(variant)}: interventions {way} over the mixed phase, from "
                f"{early:.1%} of the steps in its first third to {late:.1%} in its last."
            )
    return [sentence for sentence in sentences if sentence]


def interventions(runs: Sequence[RunResult]) -> tuple[float, float] | None:
    """Share of steps with the planner on in the first and last third of the mixed phase, if any."""
    thirds = []
    for run in runs:
        steps = np.array(run.steps)
        rate = np.array([value or 0.0 for value in run.curves["rollout/intervention_rate"]])
        mixed = rate[steps > (run.origin.get("imitation_steps") or 0)]
        if len(mixed) >= 3:
            third = len(mixed) // 3
            thirds.append((mixed[:third].mean(), mixed[-third:].mean()))
    if not thirds:
        return None
    early, late = np.mean(thirds, axis=0).tolist()
    return early, late


def _order(estimates: Estimates, key: str, words: str, sign: float) -> str:
    """Whether the variants of the paper are in its order, each of them behind none before it."""
    names = [name for name in ORDER if name in estimates and name != "paper"]
    found = {name: estimates[name][key] for name in names}
    values = {name: sign * one.value for name, one in found.items() if one.value is not None}
    if len(names) < 2 or len(values) < len(names):
        return ""
    wrong = [
        f"{label(after)} behind {label(before)} ({_apart(found[before], found[after])})"
        for before, after in combinations(names, 2)
        if values[after] < values[before]
    ]
    if not wrong:
        return f"By {words} the variants are in the paper's order."
    return f"By {words} the variants are not in the paper's order: {', '.join(wrong)}."


def _apart(one: Estimate, two: Estimate) -> str:
    """Whether the intervals of two variants tell them apart."""
    if one.bounds is None or two.bounds is None:
        return "too few runs to tell"
    overlap = one.bounds[0] <= two.bounds[1] and two.bounds[0] <= one.bounds[1]
    return f"their intervals {'overlap' if overlap else 'do not overlap'}"
