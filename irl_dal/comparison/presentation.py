"""What a comparison shows: its tables, and sentences made of its numbers."""

from collections.abc import Iterable, Mapping, Sequence
from math import inf
from typing import Any

from irl_dal.figures.style import MODE_COLOURS
from irl_dal.figures.table import Cell, Column, NumberTable
from irl_dal.planner import ProjectionMode

SAFETY_COLUMNS = (
    Column("success", "success", "%", 0, 1),
    Column("collisions_per_1k_steps", "collisions / 1k steps", "", 2, -1, "crashes /1k"),
    Column("nominal_violation_rate_planner", "planner's violations", "%", 2, -1, "planner out"),
    Column("nominal_violation_rate", "violations before", "%", 2, -1, "before shield"),
    Column("command_violation_rate", "violations after", "%", 2, -1, "after shield"),
    Column("correction_norm", "correction", "", 3, -1, "corr."),
)

RIDE_COLUMNS = (
    Column("comfort_rms_jerk", "RMS jerk", "m/s³", 1, -1),
    Column("comfort_rms_steering_rate", "steering rate", "rad/s", 3, -1, "steer"),
    Column("comfort_max_lateral_acceleration", "lateral", "m/s²", 2, -1, "lat."),
    Column("ade_m", "ADE", "m", 2, -1),
    Column("fde_m", "FDE", "m", 2, -1),
    Column("latency_plan_p50_ms", "plan p50", "ms", 1, -1, "p50"),
    Column("latency_plan_p99_ms", "p99", "ms", 1, -1),
)

STATE_COLUMNS = (  # of plans made in the same states
    Column("state_plan_nominal_violation_rate", "broken before", "%", 1, -1, "before"),
    Column("state_plan_violation_rate", "broken after", "%", 1, -1, "after"),
    Column("state_plan_correction_norm", "correction", "", 3, -1, "corr."),
    Column("state_plan_energy_unguided", "energy, not yet guided", "", 3, -1, "energy:"),
    Column("state_plan_energy_nominal", "not yet projected", "", 3, -1, "guided"),
    Column("state_plan_energy", "energy of the plan", "", 3, -1, "of plan"),
    Column("state_plan_diversity_m", "diversity", "m", 2, short="spread"),
)

ACTIVATIONS = {
    "trigger": "planner on its trigger",
    "always": "planner always on",
    "alone": "planner alone",
}


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


def best_projection(results: Mapping[str, Any]) -> ProjectionMode:
    """The projection to recommend, by the settings with the shield under the first activation.

    Most successes first; among modes that no paired interval tells apart from the best, the plan
    of least energy in the same states, then the fastest.
    """
    first = results["settings"]["activations"][0]
    modes = {
        numbers["projection"]: numbers
        for name, numbers in results["arms"].items()
        if name == f"{first}-{numbers['projection']}-shield" and numbers["projection"] != "none"
    }
    most = max(numbers["success"] for numbers in modes.values())

    def order(mode: ProjectionMode) -> tuple[float, float]:
        energy = results["states"][mode].get("state_plan_energy")
        time = modes[mode]["latency_plan_p50_ms"]
        return (inf if energy is None else round(energy, 3), inf if time is None else time)

    highs = {mode: (numbers["success_ci95"] or (most,))[-1] for mode, numbers in modes.items()}
    able = [mode for mode in modes if max(highs[mode], modes[mode]["success"]) >= most]
    return min(able, key=order)


def conclusions(results: Mapping[str, Any]) -> list[str]:
    """Sentences for the head of the page; the first is the main result."""
    activations, arms = results["settings"]["activations"], results["arms"]
    pure = arms[f"{activations[-1]}-none-bare"]
    shielded = [numbers for numbers in arms.values() if numbers["shielded"]]
    worst = max(numbers["command_violation_rate"] for numbers in shielded)
    held = "not one command" if worst == 0.0 else f"up to {100.0 * worst:.2f} % of the commands"
    best = best_projection(results)
    ours, baseline = arms[f"{activations[0]}-{best}-shield"], arms[f"{activations[0]}-none-bare"]
    return [
        f"Of the commands that pure diffusion executed ({ACTIVATIONS[activations[-1]]}), "
        f"{100.0 * pure['command_violation_rate']:.1f} % broke a bound; with the shield {held} "
        f"did, in {sum(numbers['steps'] for numbers in shielded):,} steps.",
        f"{best} with the shield succeeded in {100.0 * ours['success']:.0f} % of the episodes, "
        f"pure diffusion in {100.0 * baseline['success']:.0f} % (paired difference "
        f"{_points(ours, 'success')}); difference in "
        f"collisions {_points(ours, 'collision_rate')}.",
        _guidance(results),
    ]


def _guidance(results: Mapping[str, Any]) -> str:
    """What the energies did to the plans and to the drives, in the mode without guidance too."""
    arms, states = results["arms"], results["states"]
    (mode,) = {numbers["projection"] for numbers in arms.values() if not numbers["guided"]}
    drives = []
    for activation in results["settings"]["activations"]:
        both = (arms[f"{activation}-{mode}-shield{end}"]["success"] for end in ("", "-unguided"))
        shares = " against ".join(f"{100.0 * success:.0f} %" for success in both)
        drives.append(f"{ACTIVATIONS[activation]} {shares}")
    sentence = f"Successes of {mode} with guidance against without: {', '.join(drives)}."
    energies = [states[name].get("state_plan_energy") for name in (mode, f"{mode}, unguided")]
    if None in energies:
        return sentence
    words = " against ".join(f"{energy:.2f}" for energy in energies)
    return f"{sentence} Mean energy of its plans in the same risky states: {words}."


def _points(numbers: Mapping[str, Any], key: str) -> str:
    """A paired difference in percentage points with its interval."""
    value, bounds = numbers[f"{key}_vs_none"], numbers[f"{key}_vs_none_ci95"]
    if value is None or bounds is None:
        return "unknown"
    if value == bounds[0] == bounds[1] == 0.0:
        return "0 in every episode"
    low, high = (100.0 * bound for bound in bounds)
    return f"{100.0 * value:+.0f} points, 95 % interval {low:+.0f} to {high:+.0f}"
