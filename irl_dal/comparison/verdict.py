"""What a comparison found, in sentences made of its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from irl_dal.comparison.table import ACTIVATIONS
from irl_dal.planner import ProjectionMode

__all__ = ["champion", "findings"]


def champion(report: Mapping[str, Any]) -> ProjectionMode:
    """The projection to recommend, by the arms with the shield under the first activation.

    Most successes first; among modes that no paired interval tells apart from the best, the plan
    of least energy in the same states, then the fastest.
    """
    activation = report["settings"]["activations"][0]
    arms = {
        arm["projection"]: arm
        for arm in report["arms"].values()
        if arm["activation"] == activation
        and arm["shielded"]
        and arm["guided"]
        and arm["projection"] != "none"
    }
    most = max(arm["success"] for arm in arms.values())
    leaders = [mode for mode, arm in arms.items() if _reaches(arm, most)]

    def order(mode: ProjectionMode) -> tuple[float, float]:
        energy = report["states"][mode].get("state_plan_energy")
        time = arms[mode]["latency_plan_p50_ms"]
        infinite = float("inf")
        return (
            infinite if energy is None else round(energy, 3),
            infinite if time is None else time,
        )

    return min(leaders, key=order)


def _reaches(arm: Mapping[str, Any], most: float) -> bool:
    """Whether an arm's interval holds the best success."""
    bounds = arm["success_ci95"]
    return bounds is None or arm["success"] == most or bool(bounds[1] >= most)


def findings(report: Mapping[str, Any]) -> list[str]:
    """Sentences for the head of the page; the first is the finding."""
    activation = report["settings"]["activations"][-1]
    arms = report["arms"]
    pure = arms[f"{activation}-none-bare"]
    shielded = [arm for arm in arms.values() if arm["shielded"]]
    worst = max(arm["command_violation_rate"] for arm in shielded)
    best = champion(report)
    first = report["settings"]["activations"][0]
    ours, theirs = arms[f"{first}-{best}-shield"], arms[f"{first}-none-bare"]
    held = "not one command" if worst == 0.0 else f"up to {100.0 * worst:.2f} % of the commands"
    sentences = [
        f"Of the commands that pure diffusion executed ({ACTIVATIONS[activation]}), "
        f"{100.0 * pure['command_violation_rate']:.1f} % broke a bound; with the shield {held} "
        f"did, in {sum(arm['steps'] for arm in shielded):,} steps."
    ]
    sentences.append(
        f"{best} with the shield succeeded in {100.0 * ours['success']:.0f} % of the episodes, "
        f"pure diffusion in {100.0 * theirs['success']:.0f} % (paired difference "
        f"{_points(ours, 'success')}); difference in "
        f"collisions {_points(ours, 'collision_rate')}."
    )
    return [*sentences, _guidance(report)]


def _guidance(report: Mapping[str, Any]) -> str:
    """What the energies did to the plans and to the drives, in the mode without guidance too."""
    arms, states = report["arms"], report["states"]
    (mode,) = {arm["projection"] for arm in arms.values() if not arm["guided"]}
    drives = []
    for activation in report["settings"]["activations"]:
        with_it, without = (arms[f"{activation}-{mode}-shield{end}"] for end in ("", "-unguided"))
        drives.append(
            f"{ACTIVATIONS[activation]} {100.0 * with_it['success']:.0f} % against "
            f"{100.0 * without['success']:.0f} %"
        )
    sentence = f"Successes of {mode} with guidance against without: {', '.join(drives)}."
    guided, unguided = (
        states[name].get("state_plan_energy") for name in (mode, f"{mode}, unguided")
    )
    if guided is None or unguided is None:
        return sentence
    return (
        f"{sentence} Mean energy of its plans in the same risky states: {guided:.2f} against "
        f"{unguided:.2f}."
    )


def _points(arm: Mapping[str, Any], key: str) -> str:
    """A paired difference in percentage points with its interval."""
    value, bounds = arm[f"{key}_vs_none"], arm[f"{key}_vs_none_ci95"]
    if value is None or bounds is None:
        return "unknown"
    if value == bounds[0] == bounds[1] == 0.0:
        return "0 in every episode"
    low, high = (100.0 * bound for bound in bounds)
    return f"{100.0 * value:+.0f} points, 95 % interval {low:+.0f} to {high:+.0f}"
