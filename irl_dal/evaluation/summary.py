"""The printed table and the JSON file of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.table import Table

from irl_dal.evaluation.metrics import Value

__all__ = ["evaluation_table"]


@dataclass(frozen=True, slots=True)
class _Row:
    """How a metric is printed.

    Attributes:
        label: Words before the number.
        unit: Unit behind it; "%" prints a fraction times 100.
        digits: Digits after the point.
    """

    label: str
    unit: str = ""
    digits: int = 3


_ROWS = {
    "success": _Row("success", "%", 1),
    "collision_rate": _Row("  ended by a collision", "%", 1),
    "off_road_rate": _Row("  left the road", "%", 1),
    "timeout_rate": _Row("  ran out of time", "%", 1),
    "collisions_per_1k_steps": _Row("collisions / 1k steps"),
    "normalized_return": _Row("normalised return [0, 200]", "", 1),
    "bc_loss": _Row("BC loss, held out, balanced", "", 4),
    "action_similarity": _Row("action similarity", "%", 1),
    "ade_m": _Row("ADE", "m", 2),
    "fde_m": _Row("FDE", "m", 2),
    "command_violation_rate": _Row("executed commands out of bounds", "%", 2),
    "nominal_violation_rate": _Row("before the shield", "%", 2),
    "nominal_violation_rate_policy": _Row("  policy", "%", 2),
    "nominal_violation_rate_planner": _Row("  planner", "%", 2),
    "nominal_violation_rate_blend": _Row("  blend", "%", 2),
    "nominal_violation_rate_expert": _Row("  expert", "%", 2),
    "intervention_rate": _Row("steps with the planner triggered", "%", 1),
    "projection_active_rate": _Row("steps changed by the shield", "%", 1),
    "plan_projection_rate": _Row("plans changed by projection", "%", 1),
    "correction_norm": _Row("correction norm", "", 4),
    "comfort_rms_jerk": _Row("RMS jerk", "m/s³", 2),
    "comfort_max_lateral_acceleration": _Row("largest lateral acceleration", "m/s²", 2),
    "comfort_rms_steering_rate": _Row("RMS steering rate", "rad/s", 3),
    "latency_plan_p50_ms": _Row("one plan, median", "ms", 2),
    "latency_plan_p99_ms": _Row("  p99", "ms", 2),
    "latency_plan_max_ms": _Row("  longest", "ms", 2),
    "latency_shield_p50_ms": _Row("one shield call, median", "ms", 2),
    "latency_shield_p99_ms": _Row("  p99", "ms", 2),
    "latency_shield_max_ms": _Row("  longest", "ms", 2),
}


def evaluation_table(report: Mapping[str, Value], title: str) -> Table:
    """The table that evaluation prints.

    Args:
        report: Flat report of an evaluation.
        title: Line above the table.
    """
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("metric", no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("95 % interval", justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for name, row in _ROWS.items():
        interval = _interval(report.get(f"{name}_ci95"), row)
        table.add_row(row.label, _number(report.get(name), row), interval, row.unit)
    table.caption = (
        f"{report['episodes']} episodes, {report['steps']} steps; "
        f"processes at a time: {report['latency_processes']}, threads: {report['latency_threads']}"
    )
    table.caption_justify = "left"
    return table


def _number(value: Value, row: _Row) -> str:
    if not isinstance(value, int | float):
        return "–"
    scale = 100.0 if row.unit == "%" else 1.0
    return f"{scale * value:.{row.digits}f}"


def _interval(bounds: Value, row: _Row) -> str:
    if not isinstance(bounds, list):
        return ""
    return " … ".join(_number(bound, row) for bound in bounds)
