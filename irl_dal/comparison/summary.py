"""From the kept rows to the numbers that `irl_dal/evaluation/metrics.py` defines, and gaps."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irl_dal.comparison.config import Setting
from irl_dal.evaluation.metrics import STATISTICS, Value, join_rows, latencies
from irl_dal.evaluation.statistics import difference, estimate
from irl_dal.storage.result_store import ResultStore

Rows = Mapping[str, NDArray[np.float64]]


def summarise(
    store: ResultStore,
    settings: Sequence[Setting],
    planning: Sequence[Setting],
    seeds: Sequence[int],
) -> dict[str, Any]:
    """All numbers of a complete comparison.

    Returns:
        `arms`: per setting its flat numbers, with `<key>_ci95`, and `<key>_vs_none` and
        `<key>_vs_none_ci95`, the paired difference from its baseline on the same seeds;
        `states`: per planning setting the same of plans in the same states, against mode `none`.
    """
    rng = np.random.default_rng(seeds[0])
    episodes = {each: _read(store, f"driving/{each.name}", seeds) for each in settings}
    rows = {each: _rows(entries) for each, entries in episodes.items()}
    driven = {}
    for setting, entries in episodes.items():
        head: dict[str, Any] = {
            **asdict(setting),
            "label": setting.label,
            "episodes": len(seeds),
            "steps": sum(entry["steps"] for entry in entries),
            "seeds": list(seeds),
            "episode_success": [bool(entry["success"]) for entry in entries],
        }
        numbers = _numbers(rows[setting], rows[setting.baseline], rng)
        driven[setting.name] = head | numbers | latencies(entries)
    plans = {each: _rows(_read(store, f"planning/{each.plan_label}", seeds)) for each in planning}
    (pure,) = (each for each in planning if each.projection == "none" and each.guided)
    states = {
        each.plan_label: {"projection": each.projection, "guided": each.guided}
        | _numbers(plans[each], plans[pure], rng)
        for each in planning
    }
    return {"arms": driven, "states": states}


def _read(store: ResultStore, kind: str, seeds: Sequence[int]) -> list[dict[str, Any]]:
    entries = (store.get(kind, seed) for seed in seeds)
    return [entry for entry in entries if entry is not None]


def _rows(entries: Sequence[Mapping[str, Any]]) -> Rows:
    return join_rows(entry["rows"] for entry in entries)


def _numbers(rows: Rows, baseline: Rows, rng: np.random.Generator) -> dict[str, Value]:
    """Values, intervals and paired differences of every number that has rows."""
    numbers: dict[str, Value] = {}
    for name, table in rows.items():
        statistic = STATISTICS[name]
        numbers |= estimate(table, statistic, rng).entries(name)
        paired = np.hstack([table, baseline[name]])
        gap = estimate(paired, difference(statistic), rng)
        numbers |= gap.entries(f"{name}_vs_none")
    return numbers
