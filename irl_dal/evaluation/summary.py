"""The table that an evaluation prints."""

from collections.abc import Mapping
from typing import Any, cast

from rich.table import Table

from irl_dal.evaluation.metrics import Value
from irl_dal.figures.table import Column, terminal_table

_ROWS = (
    Column("success", "success", "%", 1),
    Column("collision_rate", "  ended by a collision", "%", 1),
    Column("off_road_rate", "  left the road", "%", 1),
    Column("at_fault_rate", "  at fault", "%", 1),
    Column("departure_rate", "  out of its lanes", "%", 1),
    Column("timeout_rate", "  ran out of time", "%", 1),
    Column("collisions_per_1k_steps", "collisions / 1k steps", "", 3),
    Column("normalized_return", "normalised return [0, 200]", "", 1),
    Column("bc_loss", "BC loss, held out, balanced", "", 4),
    Column("action_similarity", "action similarity", "%", 1),
    Column("ade_m", "ADE", "m", 2),
    Column("fde_m", "FDE", "m", 2),
    Column("command_violation_rate", "executed commands out of bounds", "%", 2),
    Column("nominal_violation_rate", "before the shield", "%", 2),
    Column("nominal_violation_rate_policy", "  policy", "%", 2),
    Column("nominal_violation_rate_planner", "  planner", "%", 2),
    Column("nominal_violation_rate_blend", "  blend", "%", 2),
    Column("nominal_violation_rate_expert", "  expert", "%", 2),
    Column("intervention_rate", "steps with the planner triggered", "%", 1),
    Column("projection_active_rate", "steps changed by the shield", "%", 1),
    Column("plan_projection_rate", "plans changed by projection", "%", 1),
    Column("correction_norm", "correction norm", "", 4),
    Column("mean_speed", "mean speed", "m/s", 2),
    Column("comfort_rms_jerk", "RMS jerk", "m/s³", 2),
    Column("comfort_harsh_rate", "  steps above 6 m/s³", "%", 2),
    Column("comfort_max_lateral_acceleration", "largest lateral acceleration", "m/s²", 2),
    Column("comfort_rms_steering_rate", "RMS steering rate", "rad/s", 3),
    Column("latency_plan_p50_ms", "one plan, median", "ms", 2),
    Column("latency_plan_p99_ms", "  p99", "ms", 2),
    Column("latency_plan_max_ms", "  longest", "ms", 2),
    Column("latency_shield_p50_ms", "one shield call, median", "ms", 2),
    Column("latency_shield_p99_ms", "  p99", "ms", 2),
    Column("latency_shield_max_ms", "  longest", "ms", 2),
)


def evaluation_table(report: Mapping[str, Value], title: str) -> Table:
    """The table of an evaluation's flat report."""
    rows = []
    for column in _ROWS:
        interval = column.interval(cast(Any, report.get(f"{column.key}_ci95")), " … ")
        rows.append([column.heading, column.text(report.get(column.key)), interval])
    table = terminal_table(title, ["", "value", "95 % interval"], rows)
    table.caption = (
        f"{report['episodes']} episodes, {report['steps']} steps; "
        f"processes at a time: {report['latency_processes']}, threads: {report['latency_threads']}"
    )
    table.caption_justify = "left"
    return table
