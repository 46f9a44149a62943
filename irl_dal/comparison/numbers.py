"""From the kept rows to numbers with intervals and paired differences; nothing is defined here.

What a number means stands in `irl_dal/evaluation/metrics.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irl_dal.comparison.settings import Arm
from irl_dal.comparison.store import ComparisonStore
from irl_dal.evaluation.metrics import STATISTICS, Value, join_rows, latencies
from irl_dal.evaluation.statistics import difference, estimate

__all__ = ["summarise"]

Array = NDArray[np.float64]

Rows = Mapping[str, Array]


def summarise(
    store: ComparisonStore, arms: Sequence[Arm], planning: Sequence[Arm], seeds: Sequence[int]
) -> dict[str, Any]:
    """All numbers of a complete comparison.

    Args:
        store: Holds every episode.
        arms: Who drove.
        planning: Who planned in the expert's risky states.
        seeds: On which seeds.

    Returns:
        `arms`: per arm its flat numbers, with `<key>_ci95`, and `<key>_vs_none` and
        `<key>_vs_none_ci95`, the paired difference from the arm's baseline on the same seeds;
        `states`: per planning arm the same of plans in the same states, against mode `none`.
    """
    rng = np.random.default_rng(seeds[0])
    kept = {arm: [_episode(store, arm, seed) for seed in seeds] for arm in arms}
    rows = {arm: join_rows(entry["rows"] for entry in kept[arm]) for arm in arms}
    driven = {}
    for arm in arms:
        numbers = _numbers(rows[arm], rows[arm.baseline], rng)
        head: dict[str, Any] = {
            "activation": arm.activation,
            "projection": arm.projection,
            "shielded": arm.shielded,
            "guided": arm.guided,
            "label": arm.label,
            "episodes": len(seeds),
            "steps": sum(entry["steps"] for entry in kept[arm]),
            "seeds": list(seeds),
            "episode_success": [bool(entry["success"]) for entry in kept[arm]],
        }
        driven[arm.name] = head | numbers | latencies(kept[arm])
    return {"arms": driven, "states": _states(store, planning, seeds, rng)}


def _states(
    store: ComparisonStore,
    planning: Sequence[Arm],
    seeds: Sequence[int],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Numbers of the plans in the same states."""
    known = []
    for seed in seeds:
        entry = store.states(seed)
        assert entry is not None
        known.append(entry)
    rows = {arm: join_rows(entry["plans"][arm.name] for entry in known) for arm in planning}
    (baseline,) = (arm for arm in planning if arm.projection == "none" and arm.guided)
    return {
        arm.label.replace(" + shield", ""): {
            "projection": arm.projection,
            "guided": arm.guided,
            **_numbers(rows[arm], rows[baseline], rng),
        }
        for arm in planning
    }


def _numbers(rows: Rows, baseline: Rows, rng: np.random.Generator) -> dict[str, Value]:
    """Values, intervals and paired differences of every number that has rows."""
    report: dict[str, Value] = {}
    for name, table in rows.items():
        statistic = STATISTICS[name]
        report |= estimate(table, statistic, rng).entries(name)
        paired = np.hstack([table, baseline[name]])
        gap = estimate(paired, difference(statistic), rng)
        report |= gap.entries(f"{name}_vs_none")
    return report


def _episode(store: ComparisonStore, arm: Arm, seed: int) -> dict[str, Any]:
    entry = store.episode(arm.name, seed)
    assert entry is not None
    return entry
