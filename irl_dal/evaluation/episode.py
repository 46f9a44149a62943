"""What is written down while an agent drives: the raw material of every number and picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from irl_dal.evaluation.statistics import Array
from irl_dal.loop import SOURCES
from irl_dal.planner import Plan

SILENT = -1  # in `Episode.nominal_violations` for a source that proposed nothing on that step


class LoggedPlan(NamedTuple):
    """A plan and the command that was executed before it (2,) [rad, m/s]."""

    plan: Plan
    previous: Array


@dataclass(frozen=True, slots=True)
class Episode:
    """One drive of T steps, as read-only arrays."""

    seed: int  # that it was reset with
    success: bool  # goal reached, no collision, never off the road, within the time limit
    collision: bool  # ended by one
    off_road: bool  # left the road
    at_fault: bool  # touched something or left its lanes, and nothing excuses it
    departed: bool  # a corner of the body was beyond the edges of its own lanes
    reward: Array  # of the environment (T,)
    pose: Array  # true x, y, yaw of the rear axle before and after each step (T+1, 3) [m, m, rad]
    speed: Array  # true speed, likewise (T+1,) [m/s]
    mode: NDArray[np.int64]  # of the expert in the state acted upon (T,)
    agent_action: Array  # the agent's own, before planner and shield (T, 2), normalised
    expert_action: Array  # the expert's label for the same state (T, 2), normalised
    previous_command: Array  # executed on the step before (T, 2) [rad, m/s]
    nominal_command: Array  # before the shield (T, 2) [rad, m/s]
    executed_command: Array  # that reached the actuators (T, 2) [rad, m/s]
    projected: NDArray[np.bool_]  # the shield changed the command (T,)
    triggered: NDArray[np.bool_]  # the planner was used (T,)
    nominal_violations: NDArray[np.int8]
    """1 where a source's proposal broke a bound before the shield, 0 where it did not, -1 where it
    proposed nothing (T, 4); columns as `irl_dal.loop.SOURCES`."""
    shield_time: Array  # of each shield call (T,) [s]; NaN where the shield is off
    plans: tuple[LoggedPlan, ...]

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @classmethod
    def of(
        cls,
        seed: int,
        infos: Sequence[Mapping[str, Any]],
        actions: Sequence[Array],
        rewards: Sequence[float],
    ) -> Self:
        """From the control loop's `info` of the reset and of each of T steps.

        `actions` are the agent's own (2,), normalised. A ValueError if there is no step.
        """
        before, after, last = infos[:-1], infos[1:], infos[-1]
        if not after:
            raise ValueError(f"`seed` {seed}: an episode needs at least one step. Got 0.")
        certificates = [info.get("certificate") for info in after]
        broken = [[info["nominal_violations"].get(s, SILENT) for s in SOURCES] for info in after]
        return cls(
            seed=seed,
            success=bool(last["success"]),
            collision=bool(last["collision"]),
            off_road=bool(last["off_road"]),
            at_fault=any(info["fault"] == "at_fault" for info in after),
            departed=any(info["departure"] for info in after),
            reward=np.array(rewards, np.float64),
            pose=_stack(infos, "pose"),
            speed=_stack(infos, "speed").reshape(-1),
            mode=np.array([int(info["mode"]) for info in before], np.int64),
            agent_action=np.array(actions, np.float64),
            expert_action=_stack(before, "expert_action"),
            previous_command=_stack(after, "previous_command"),
            nominal_command=_stack(after, "nominal_command"),
            executed_command=_stack(after, "executed_command"),
            projected=np.array([c is not None and c.intervened for c in certificates], np.bool_),
            triggered=np.array([info["triggered"] for info in after], np.bool_),
            nominal_violations=np.array(broken, np.int8),
            shield_time=np.array([np.nan if c is None else c.solve_time for c in certificates]),
            plans=tuple(
                LoggedPlan(info["plan"], info["previous_command"])
                for info in after
                if info.get("plan") is not None
            ),
        )

    @property
    def steps(self) -> int:
        """Number of control steps T."""
        return len(self.reward)

    @property
    def total_reward(self) -> float:
        """Undiscounted sum of the environment reward."""
        return float(self.reward.sum())


def _stack(infos: Sequence[Mapping[str, Any]], key: str) -> Array:
    return np.array([info[key] for info in infos], np.float64)
