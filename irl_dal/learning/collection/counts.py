"""What happened in a training so far, in numbers that only grow."""

from __future__ import annotations

from dataclasses import dataclass, fields

__all__ = ["Counts"]


@dataclass(frozen=True, slots=True)
class Counts:
    """Of one step, of a stretch of steps or of a whole training.

    Attributes:
        steps: Environment steps.
        episodes: Episodes that came to an end.
        successes: Of these, goal reached without any violation.
        collisions: Of these, ended by a collision.
        triggers: Steps on which the planner was used.
        plans_projected: Plans that the planner's projection changed.
        plan_fallbacks: Plans that were fallbacks.
        shield_corrections: Steps on which the shield changed the command.
        command_violations: Steps whose executed command broke a bound: must stay 0 with the shield.
        policy_violations: Steps on which the policy's own command would have broken a bound.
        reward: Sum of the environment reward.
        disagreement: Sum of mean abs(policy's own action - label) / 2 over the policy's steps.
    """

    steps: int = 0
    episodes: int = 0
    successes: int = 0
    collisions: int = 0
    triggers: int = 0
    plans_projected: int = 0
    plan_fallbacks: int = 0
    shield_corrections: int = 0
    command_violations: int = 0
    policy_violations: int = 0
    reward: float = 0.0
    disagreement: float = 0.0

    def __add__(self, other: Counts) -> Counts:
        return Counts(*(getattr(self, e.name) + getattr(other, e.name) for e in fields(self)))

    def __sub__(self, earlier: Counts) -> Counts:
        return Counts(*(getattr(self, e.name) - getattr(earlier, e.name) for e in fields(self)))
