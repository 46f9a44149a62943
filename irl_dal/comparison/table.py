"""The tables that a comparison prints, and the rows of those on its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

__all__ = [
    "ACTIVATIONS",
    "DRIVE_COLUMNS",
    "RIDE_COLUMNS",
    "SAFETY_COLUMNS",
    "STATE_COLUMNS",
    "Column",
    "cell",
    "comparison_tables",
]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the table.

    Attributes:
        key: Name of the number in the report.
        title: Above the column.
        unit: Behind the title; "%" prints a fraction times 100.
        digits: After the point.
        better: Whether more (1) or less (-1) is better; 0 for neither.
        short: Title where there is little room, "" for the same.
    """

    key: str
    title: str
    unit: str = ""
    digits: int = 2
    better: int = 0
    short: str = ""

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def number(self, value: Any) -> str:
        """A value, an en dash where there is none."""
        if not isinstance(value, int | float):
            return "–"
        return f"{(100.0 if self.unit == '%' else 1.0) * value:.{self.digits}f}"


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
"""Said of each arm: outcome, bounds before and after the shield."""

RIDE_COLUMNS = (
    Column("comfort_rms_jerk", "RMS jerk", "m/s³", 1, -1),
    Column("comfort_rms_steering_rate", "steering rate", "rad/s", 3, -1, short="steer"),
    Column("comfort_max_lateral_acceleration", "lateral", "m/s²", 2, -1, short="lat."),
    Column("ade_m", "ADE", "m", 2, -1),
    Column("fde_m", "FDE", "m", 2, -1),
    Column("latency_plan_p50_ms", "plan p50", "ms", 1, -1, short="p50"),
    Column("latency_plan_p99_ms", "p99", "ms", 1, -1),
)
"""Said of each arm: comfort, distance from the expert's path, time."""

DRIVE_COLUMNS = SAFETY_COLUMNS + RIDE_COLUMNS

STATE_COLUMNS = (
    Column("state_plan_nominal_violation_rate", "broken before", "%", 1, -1, short="before"),
    Column("state_plan_violation_rate", "broken after", "%", 1, -1, short="after"),
    Column("state_plan_correction_norm", "correction", "", 3, -1, short="corr."),
    Column("state_plan_energy_unguided", "energy, not yet guided", "", 3, -1, short="energy:"),
    Column("state_plan_energy_nominal", "not yet projected", "", 3, -1, short="guided"),
    Column("state_plan_energy", "energy of the plan", "", 3, -1, short="of plan"),
    Column("state_plan_diversity_m", "diversity", "m", 2, short="spread"),
)
"""What is said of plans made in the same states."""


def cell(column: Column, numbers: Mapping[str, Any]) -> tuple[str, str, str]:
    """A number, its interval and its paired difference from the baseline with interval."""
    value = column.number(numbers.get(column.key))
    return (
        value,
        _interval(column, numbers.get(f"{column.key}_ci95")),
        _difference(column, numbers),
    )


def comparison_tables(report: Mapping[str, Any]) -> list[Table]:
    """What the command prints: one table per activation and one of the states."""
    settings = report["settings"]
    tables = []
    for activation in settings["activations"]:
        arms = [arm for arm in report["arms"].values() if arm["activation"] == activation]
        title = f"{ACTIVATIONS[activation]}, {settings['episodes']} episodes"
        for columns in (SAFETY_COLUMNS, RIDE_COLUMNS):
            tables.append(_table(title, columns, [(arm["label"], arm) for arm in arms]))
    title = f"{settings['candidates']} plans in each of the same risky states, the same noise"
    tables.append(_table(title, STATE_COLUMNS, list(report["states"].items())))
    return tables


ACTIVATIONS = {
    "trigger": "planner on its trigger",
    "always": "planner always on",
    "alone": "planner alone",
}
"""Words for who is asked when."""


def _table(
    title: str, columns: Sequence[Column], rows: Sequence[tuple[str, Mapping[str, Any]]]
) -> Table:
    """Numbers in columns, the arms in rows."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=0, pad_edge=False)
    table.add_column("", no_wrap=True)
    for column in columns:
        unit = f" [{column.unit}]" if column.unit else ""
        heading = (column.short or column.title) + unit
        longest = max(len(word) for word in heading.split())
        table.add_column(Text(heading), justify="right", min_width=longest)
    for name, numbers in rows:
        table.add_row(name, *(column.number(numbers.get(column.key)) for column in columns))
    return table


def _interval(column: Column, bounds: Any) -> str:
    if not isinstance(bounds, list):
        return ""
    return " … ".join(column.number(bound) for bound in bounds)


def _difference(column: Column, numbers: Mapping[str, Any]) -> str:
    """As "+1.2 (0.3 … 2.1)"; empty without one."""
    value, bounds = (numbers.get(f"{column.key}_vs_none{end}") for end in ("", "_ci95"))
    if value is None or bounds is None:
        return ""
    sign = "+" if value >= 0.0 else "−"
    return f"{sign}{column.number(abs(value))} ({_interval(column, bounds)})"
