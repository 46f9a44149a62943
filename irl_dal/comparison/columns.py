"""The tables of a comparison."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from irl_dal.figures.style import MODE_COLOURS
from irl_dal.figures.table import Cell, Column, NumberTable

SAFETY_COLUMNS = (
    Column("success", "success", "%", 0, 1),
    Column("collisions_per_1k_steps", "collisions / 1k steps", "", 2, -1, short="crashes /1k"),
    Column(
        "nominal_violation_rate_planner", "planner's violations", "%", 2, -1, short="planner out"
    ),
    Column("nominal_violation_rate", "violations before", "%", 2, -1, short="before shield"),
    Column("command_violation_rate", "violations after", "%", 2, -1, short="after shield"),
    Column("correction_norm", "correction", "", 3, -1, short="corr."),
)
"""Outcome, and bounds before and after the shield."""

RIDE_COLUMNS = (
    Column("comfort_rms_jerk", "RMS jerk", "m/s³", 1, -1),
    Column("comfort_rms_steering_rate", "steering rate", "rad/s", 3, -1, short="steer"),
    Column("comfort_max_lateral_acceleration", "lateral", "m/s²", 2, -1, short="lat."),
    Column("ade_m", "ADE", "m", 2, -1),
    Column("fde_m", "FDE", "m", 2, -1),
    Column("latency_plan_p50_ms", "plan p50", "ms", 1, -1, short="p50"),
    Column("latency_plan_p99_ms", "p99", "ms", 1, -1),
)
"""Comfort, distance from the expert's path, time."""

STATE_COLUMNS = (
    Column("state_plan_nominal_violation_rate", "broken before", "%", 1, -1, short="before"),
    Column("state_plan_violation_rate", "broken after", "%", 1, -1, short="after"),
    Column("state_plan_correction_norm", "correction", "", 3, -1, short="corr."),
    Column("state_plan_energy_unguided", "energy, not yet guided", "", 3, -1, short="energy:"),
    Column("state_plan_energy_nominal", "not yet projected", "", 3, -1, short="guided"),
    Column("state_plan_energy", "energy of the plan", "", 3, -1, short="of plan"),
    Column("state_plan_diversity_m", "diversity", "m", 2, short="spread"),
)
"""Plans made in the same states."""

ACTIVATIONS = {
    "trigger": "planner on its trigger",
    "always": "planner always on",
    "alone": "planner alone",
}
"""Words for when the planner plans."""


def comparison_tables(results: Mapping[str, Any]) -> list[NumberTable]:
    """Two tables per activation and one of the states, for terminal and page."""
    extent = results["settings"]
    safety = (
        f"{extent['episodes']} episodes from seed {extent['first_seed']}, the same seeds and the "
        "same noise in every setting. Below each number its 95 % bootstrap interval; the paired "
        "difference from none without a shield is in the figures below and appears when the "
        "pointer rests on a number. Violations: share of steps whose command breaks a bound, as "
        "the planner proposed it, before and after the shield."
    )
    ride = (
        "ADE, FDE: mean and final distance from the expert's path over "
        f"{extent['path_duration']:.0f} s from states of its drive. Lateral: largest acceleration."
    )
    states = (
        f"At most {extent['states']} states per expert's episode; of the plans in a state the one "
        "of least energy counts. Diversity: mean distance between the ends of two candidates."
    )
    tables = []
    for activation in extent["activations"]:
        rows = [
            (numbers["label"], numbers)
            for numbers in results["arms"].values()
            if numbers["activation"] == activation
        ]
        title = f"{ACTIVATIONS[activation]}, {extent['episodes']} episodes"
        tables += [
            _table(f"{title}: safety", SAFETY_COLUMNS, rows, safety),
            _table(f"{title}: ride", RIDE_COLUMNS, rows, ride),
        ]
    title = f"{extent['candidates']} plans in each of the same risky states, the same noise"
    return [*tables, _table(title, STATE_COLUMNS, results["states"].items(), states)]


def _table(
    title: str,
    columns: Sequence[Column],
    rows: Iterable[tuple[str, Mapping[str, Any]]],
    caption: str,
) -> NumberTable:
    """Numbers in columns, the settings in rows."""
    cells = [
        (name, MODE_COLOURS[numbers["projection"]], [_cell(column, numbers) for column in columns])
        for name, numbers in rows
    ]
    headings, short = zip(*((c.heading, c.short_heading) for c in columns), strict=True)
    return NumberTable(title, headings, cells, caption, short=short)


def _cell(column: Column, numbers: Mapping[str, Any]) -> Cell:
    """A number with its interval; the paired difference from the baseline as a hint."""
    value = numbers.get(column.key)
    mark = ""
    if column.key in ("command_violation_rate", "state_plan_violation_rate") and value is not None:
        mark = "hot" if value else "zero"
    interval = column.interval(numbers.get(f"{column.key}_ci95"), " … ")
    return Cell(column.text(value), (interval,), _difference(column, numbers), mark)


def _difference(column: Column, numbers: Mapping[str, Any]) -> str:
    """As "against none: +1.2 (0.3 … 2.1)"; empty without one."""
    value, bounds = (numbers.get(f"{column.key}_vs_none{end}") for end in ("", "_ci95"))
    if value is None or bounds is None:
        return ""
    sign = "+" if value >= 0.0 else "−"
    return f"against none: {sign}{column.text(abs(value))} ({column.interval(bounds, ' … ')})"
