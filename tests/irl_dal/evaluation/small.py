"""A city and an extent small enough for tests, and episodes written by hand."""

from dataclasses import replace

import numpy as np

from irl_dal.config import RunConfig
from irl_dal.evaluation.config import EvaluationConfig
from irl_dal.evaluation.episode import Episode, LoggedPlan
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.planner import Plan
from shield import Status


def small_config(**extent: float) -> RunConfig:
    """Episodes of at most 20 steps, an evaluation of two of them."""
    config = RunConfig()
    city = replace(
        config.env, route_length=80.0, route_spread=0.0, time_limit=2.0, difficulty="easy"
    )
    sizes = {"episodes": 2, "held_out_episodes": 1, "path_states": 3}
    evaluation = EvaluationConfig(**{**sizes, "n_jobs": 1, **extent})
    return replace(config, env=city, evaluation=evaluation)


def small_rig(policy: str = "expert", **extent: float) -> Rig:
    """A rig in that city."""
    return Rig.build(small_config(**extent), AgentSpec(policy))


def written_episode(steps: int = 4, **entries: object) -> Episode:
    """An uneventful episode: standing still, nobody disagrees; `entries` replace its arrays."""
    still = np.zeros((steps, 2))
    values: dict[str, object] = {
        "seed": 0,
        "success": True,
        "collision": False,
        "off_road": False,
        "at_fault": False,
        "departed": False,
        "reward": np.ones(steps),
        "pose": np.zeros((steps + 1, 3)),
        "speed": np.zeros(steps + 1),
        "mode": np.zeros(steps, np.int64),
        "agent_action": still,
        "expert_action": still,
        "previous_command": still,
        "nominal_command": still,
        "executed_command": still,
        "projected": np.zeros(steps, np.bool_),
        "triggered": np.zeros(steps, np.bool_),
        "nominal_violations": np.full((steps, 4), -1, np.int8),
        "shield_time": np.full(steps, np.nan),
        "plans": (),
    }
    arrays = {
        name: value.copy() if isinstance(value, np.ndarray) else value
        for name, value in {**values, **entries}.items()
    }
    return Episode(**arrays)


def logged_plan(**entries: object) -> LoggedPlan:
    """A plan to stand still, eight commands long, of one candidate; `entries` replace its parts."""
    still = np.zeros((8, 2))
    values: dict[str, object] = {
        "actions": still,
        "nominal": still,
        "status": Status.NOMINAL,
        "reason": "",
        "energy": np.nan,
        "energy_nominal": np.nan,
        "energy_unguided": np.nan,
        "candidates": still[None],
        "latency": 0.01,
    }
    return LoggedPlan(Plan(**{**values, **entries}), np.zeros(2))
