"""What a comparison shows, in sentences made of its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

from irl_dal.comparison.columns import ACTIVATIONS
from irl_dal.planner import ProjectionMode


def best_projection(results: Mapping[str, Any]) -> ProjectionMode:
    """The projection to recommend, by the settings with the shield under the first activation.

    Most successes first; among modes that no paired interval tells apart from the best, the plan
    of least energy in the same states, then the fastest.
    """
    activation = results["settings"]["activations"][0]
    modes = {
        numbers["projection"]: numbers
        for numbers in results["arms"].values()
        if numbers["activation"] == activation
        and numbers["shielded"]
        and numbers["guided"]
        and numbers["projection"] != "none"
    }
    most = max(numbers["success"] for numbers in modes.values())

    def order(mode: ProjectionMode) -> tuple[float, float]:
        energy = results["states"][mode].get("state_plan_energy")
        time = modes[mode]["latency_plan_p50_ms"]
        return (inf if energy is None else round(energy, 3), inf if time is None else time)

    return min((mode for mode, numbers in modes.items() if _reaches(numbers, most)), key=order)


def _reaches(numbers: Mapping[str, Any], most: float) -> bool:
    """Whether a setting's interval holds the best success."""
    bounds = numbers["success_ci95"]
    return bounds is None or numbers["success"] == most or bool(bounds[1] >= most)


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
        with_it, without = (arms[f"{activation}-{mode}-shield{end}"] for end in ("", "-unguided"))
        drives.append(
            f"{ACTIVATIONS[activation]} {100.0 * with_it['success']:.0f} % against "
            f"{100.0 * without['success']:.0f} %"
        )
    sentence = f"Successes of {mode} with guidance against without: {', '.join(drives)}."
    energies = [states[name].get("state_plan_energy") for name in (mode, f"{mode}, unguided")]
    if None in energies:
        return sentence
    return (
        f"{sentence} Mean energy of its plans in the same risky states: {energies[0]:.2f} against "
        f"{energies[1]:.2f}."
    )


def _points(numbers: Mapping[str, Any], key: str) -> str:
    """A paired difference in percentage points with its interval."""
    value, bounds = numbers[f"{key}_vs_none"], numbers[f"{key}_vs_none_ci95"]
    if value is None or bounds is None:
        return "unknown"
    if value == bounds[0] == bounds[1] == 0.0:
        return "0 in every episode"
    low, high = (100.0 * bound for bound in bounds)
    return f"{100.0 * value:+.0f} points, 95 % interval {low:+.0f} to {high:+.0f}"
