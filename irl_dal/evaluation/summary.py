"""The table that an evaluation prints."""

from __future__ import annotations

from collections.abc import Mapping

from rich.box import SIMPLE_HEAD
from rich.table import Table

from irl_dal.evaluation.metrics import Value

_ROWS = {
    "success": ("success", "%", 1),
    "collision_rate": ("  ended by a collision", "%", 1),
    "off_road_rate": ("  left the road", "%", 1),
    "timeout_rate": ("  ran out of time", "%", 1),
    "collisions_per_1k_steps": ("collisions / 1k steps", "", 3),
    "normalized_return": ("normalised return [0, 200]", "", 1),
    "bc_loss": ("BC loss, held out, balanced", "", 4),
    "action_similarity": ("action similarity", "%", 1),
    "ade_m": ("ADE", "m", 2),
    "fde_m": ("FDE", "m", 2),
    "command_violation_rate": ("executed commands out of bounds", "%", 2),
    "nominal_violation_rate": ("before the shield", "%", 2),
    "nominal_violation_rate_policy": ("  policy", "%", 2),
    "nominal_violation_rate_planner": ("  planner", "%", 2),
    "nominal_violation_rate_blend": ("  blend", "%", 2),
    "nominal_violation_rate_expert": ("  expert", "%", 2),
    "intervention_rate": ("steps with the planner triggered", "%", 1),
    "projection_active_rate": ("steps changed by the shield", "%", 1),
    "plan_projection_rate": ("plans changed by projection", "%", 1),
    "correction_norm": ("correction norm", "", 4),
    "comfort_rms_jerk": ("RMS jerk", "m/s³", 2),
    "comfort_max_lateral_acceleration": ("largest lateral acceleration", "m/s²", 2),
    "comfort_rms_steering_rate": ("RMS steering rate", "rad/s", 3),
    "latency_plan_p50_ms": ("one plan, median", "ms", 2),
    "latency_plan_p99_ms": ("  p99", "ms", 2),
    "latency_plan_max_ms": ("  longest", "ms", 2),
    "latency_shield_p50_ms": ("one shield call, median", "ms", 2),
    "latency_shield_p99_ms": ("  p99", "ms", 2),
    "latency_shield_max_ms": ("  longest", "ms", 2),
}
"""Metric: label, unit ("%" prints a fraction times 100), digits after the point."""


def evaluation_table(report: Mapping[str, Value], title: str) -> Table:
    """The table of an evaluation's flat report."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("metric", no_wrap=True)
    for name in ("value", "95 % interval"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for key, (label, unit, digits) in _ROWS.items():
        bounds = report.get(f"{key}_ci95")
        ends = bounds if isinstance(bounds, list) else []
        interval = " … ".join(_number(end, unit, digits) for end in ends)
        table.add_row(label, _number(report.get(key), unit, digits), interval, unit)
    table.caption = (
        f"{report['episodes']} episodes, {report['steps']} steps; "
        f"processes at a time: {report['latency_processes']}, threads: {report['latency_threads']}"
    )
    table.caption_justify = "left"
    return table


def _number(value: Value, unit: str, digits: int) -> str:
    if not isinstance(value, int | float):
        return "–"
    return f"{(100.0 if unit == '%' else 1.0) * value:.{digits}f}"
