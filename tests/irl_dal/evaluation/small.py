"""A city and an extent small enough for tests, and episodes written by hand."""

from dataclasses import replace

import numpy as np

from irl_dal.config import RunConfig
from irl_dal.evaluation.config import EvaluationConfig
from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.plan_log import PlanLog
from irl_dal.evaluation.rig import AgentSpec, Bench


def small_config(**extent: float) -> RunConfig:
    """Episodes of at most 40 steps, an evaluation of two of them."""
    config = RunConfig()
    city = replace(
        config.env, route_length=80.0, route_spread=0.0, time_limit=4.0, difficulty="easy"
    )
    sizes = {"episodes": 2, "held_out_episodes": 1, "path_states": 3, "path_duration": 1.0}
    evaluation = EvaluationConfig(**{**sizes, "n_jobs": 1, **extent})
    return replace(config, env=city, evaluation=evaluation)


def small_bench(policy: str = "expert", **extent: float) -> Bench:
    """A bench in that city."""
    return Bench.build(small_config(**extent), AgentSpec(policy))


def written_episode(steps: int = 4, **entries: object) -> Episode:
    """An uneventful episode: standing still, nobody disagrees; `entries` replace its arrays."""
    still = np.zeros((steps, 2))
    values: dict[str, object] = {
        "seed": 0,
        "success": True,
        "collision": False,
        "off_road": False,
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
        "plans": PlanLog.empty(),
    }
    arrays = {
        name: value.copy() if isinstance(value, np.ndarray) else value
        for name, value in {**values, **entries}.items()
    }
    return Episode(**arrays)


def plan_log(plans: int) -> PlanLog:
    """So many plans to stand still, eight commands long, of one candidate each."""
    still = np.zeros((plans, 8, 2))
    return PlanLog(
        previous=np.zeros((plans, 2)),
        nominal=still.copy(),
        actions=still.copy(),
        candidates=still[:, None].copy(),
        energy=np.full((plans, 3), np.nan),
        latency=np.full(plans, 0.01),
        changed=np.zeros(plans, np.bool_),
        fallback=np.zeros(plans, np.bool_),
    )
