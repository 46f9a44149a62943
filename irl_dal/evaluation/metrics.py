"""Every number that the project reports, from logged drives and nothing else.

Shares are fractions. `<key>_ci95` is the 95 % bootstrap interval [low, high] over episodes, for
`ade_m` and `fde_m` over the compared stretches. What could not be measured is null.

* `success`: share of episodes with the goal reached, no collision, never off the road, in time;
  `collision_rate`, `off_road_rate`, `timeout_rate`: share of episodes with that flaw;
  `episode_success`: the same per episode, in the order of `seeds`.
* `collisions_per_1k_steps`: 1000 * collisions / steps. A collision is an event, it ends an episode.
* `mean_return`: mean over episodes of the undiscounted sum of the environment reward.
* `normalized_return`: 200 (R - R_random) / (R_expert - R_random) on the same seeds, clipped to
  [0, 200].
* `bc_loss`: squared difference of the agent's and the expert's action, mean over both components
  and over held-out expert states, each mode with the same weight, normalised units.
* `action_similarity`: 1 - mean|a_agent - a_expert| / 2, the agent's own action before planner and
  shield, in the states that it visits.
* `ade_m`, `fde_m`: mean and final distance between the agent's and the expert's path [m].
* `command_violation_rate`: share of steps whose executed command breaks a bound (box, rate, lateral
  acceleration), without a tolerance. `nominal_violation_rate`: the same for the command that the
  shield was given; `nominal_violation_rate_<source>`: for what policy, planner, blend and expert
  proposed, over the steps on which they did.
* `intervention_rate`: share of steps on which the planner was triggered.
* `projection_active_rate`: share of steps on which the shield changed the command.
  `plan_projection_rate`: share of plans that the planner's own projection changed;
  `plan_fallback_rate`: share of plans without a usable sample.
* `plan_nominal_violation_rate`, `plan_violation_rate`: share of plans of which any command breaks a
  bound, from the last executed command on, before the last projection and as handed over.
  `plan_correction_norm`: mean norm over their steps of what that projection changed, normalised
  units. `plan_energy_unguided`, `plan_energy_nominal`, `plan_energy`: mean energy of the last
  estimate before its guidance step, before its projection, and of the plan, fallbacks left out.
  `plan_diversity_m`: mean distance between the ends of two candidates of a plan [m].
  `state_plan_*`: the same of plans that were made in logged states and not driven.
* `correction_norm`: mean norm of executed minus nominal action, normalised units.
* `comfort_rms_jerk` [m/s^3], `comfort_max_lateral_acceleration` [m/s^2] (true speed times true yaw
  rate), `comfort_rms_steering_rate` [rad/s] (of the executed command).
* `latency_plan_*_ms`, `latency_shield_*_ms`: p50, p99 and max of one plan and of one shield call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from expert import Mode
from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.measurements import HeldOutActions, Measurements, ReferenceReturns
from irl_dal.evaluation.plan_log import PlanLog
from irl_dal.evaluation.statistics import (
    Estimate,
    Statistic,
    balanced_mean,
    estimate,
    maximum,
    ratio,
    root_ratio,
)
from irl_dal.loop import SOURCES
from irl_dal.planner.rollout import ego_rollout
from shield import ActuatorLimits

__all__ = [
    "METRICS",
    "PLAN_METRICS",
    "STATISTICS",
    "Value",
    "compute_metrics",
    "latencies",
    "metric_rows",
]

Array = NDArray[np.float64]

Value = float | int | str | list[float] | list[int] | list[bool] | None
"""What an entry of the flat report can be."""

RETURN_SCALE = 200.0
"""The expert's normalised return."""

_Rows = Callable[[Episode, ActuatorLimits], Sequence[float] | tuple[float, ...]]

_PlanRow = Callable[[PlanLog, ActuatorLimits], tuple[float, float]]


def compute_metrics(
    measurements: Measurements, limits: ActuatorLimits, rng: np.random.Generator
) -> dict[str, Value]:
    """All numbers of an evaluation under their names.

    Args:
        measurements: What was logged.
        limits: The bounds that commands are judged by; its `dt` is the control step.
        rng: Random source of the bootstrap.

    Returns:
        Flat mapping, ready for JSON.

    Raises:
        ValueError: If there are no episodes.
    """
    episodes = measurements.episodes
    if not episodes:
        raise ValueError("`measurements.episodes` must hold at least one episode. Got 0.")
    report: dict[str, Value] = {
        "episodes": len(episodes),
        "steps": sum(episode.steps for episode in episodes),
        "seeds": [episode.seed for episode in episodes],
        "episode_success": [episode.success for episode in episodes],
    }
    for name, result in _estimates(measurements, limits, rng).items():
        report[name] = result.value
        if result.low is not None and result.high is not None:
            report[f"{name}_ci95"] = [result.low, result.high]
        else:
            report[f"{name}_ci95"] = None
    return report | latencies(
        np.concatenate([episode.plans.latency for episode in episodes]),
        np.concatenate([episode.shield_time for episode in episodes]),
    )


def _estimates(
    measurements: Measurements, limits: ActuatorLimits, rng: np.random.Generator
) -> dict[str, Estimate]:
    """Each metric that has an interval."""
    rows = metric_rows(measurements, limits)
    rows["normalized_return"] = _return_rows(measurements.episodes, measurements.references)
    rows["bc_loss"] = _held_out_rows(measurements.held_out)
    return {name: estimate(table, STATISTICS[name], rng) for name, table in rows.items()}


def metric_rows(measurements: Measurements, limits: ActuatorLimits) -> dict[str, Array]:
    """What the numbers that need no reference are made of, one row per episode, stretch or log.

    Rows of several evaluations can be joined: `STATISTICS[name]` of them is the number.

    Args:
        measurements: What was logged.
        limits: The bounds that commands are judged by.

    Returns:
        Name -> (N, K).
    """
    episodes = measurements.episodes
    rows = {
        name: np.array([row(episode, limits) for episode in episodes], np.float64)
        for name, (row, _) in METRICS.items()
    }
    for prefix, logs in (
        ("", [episode.plans for episode in episodes]),
        ("state_", measurements.state_plans),
    ):
        for name, row in PLAN_METRICS.items():
            found = [row(log, limits) for log in logs]
            rows[prefix + name] = np.array(found, np.float64).reshape(-1, 2)
    distances = [np.linalg.norm(p.agent - p.expert, axis=1) for p in measurements.pairs]
    rows["ade_m"] = _pairs_rows([d.mean() for d in distances])
    rows["fde_m"] = _pairs_rows([d[-1] for d in distances])
    return rows


def _share(flag: Callable[[Episode], bool]) -> _Rows:
    """Rows for a share of episodes."""
    return lambda episode, _limits: (float(flag(episode)), 1.0)


def _per_step(total: Callable[[Episode], float]) -> _Rows:
    """Rows for a mean over steps of something with a known sum per episode."""
    return lambda episode, _limits: (float(total(episode)), float(episode.steps))


def _source(column: int) -> _Rows:
    """Rows for the share of a source's proposals that broke a bound."""

    def row(episode: Episode, _limits: ActuatorLimits) -> tuple[float, float]:
        proposals = episode.nominal_violations[:, column]
        return float((proposals == 1).sum()), float((proposals >= 0).sum())

    return row


def _violations(commands: Array, episode: Episode, limits: ActuatorLimits) -> tuple[float, float]:
    broken = [
        limits.violated(command, previous)
        for command, previous in zip(commands, episode.previous_command, strict=True)
    ]
    return float(sum(broken)), float(len(broken))


def _command_violations(episode: Episode, limits: ActuatorLimits) -> tuple[float, float]:
    return _violations(episode.executed_command, episode, limits)


def _nominal_violations(episode: Episode, limits: ActuatorLimits) -> tuple[float, float]:
    return _violations(episode.nominal_command, episode, limits)


def _correction(episode: Episode, limits: ActuatorLimits) -> tuple[float, float]:
    change = limits.to_action(episode.executed_command) - limits.to_action(episode.nominal_command)
    return float(np.linalg.norm(change, axis=1).sum()), float(episode.steps)


def _plan_share(flags: Callable[[PlanLog], Array | NDArray[np.bool_]]) -> _PlanRow:
    """Rows for a share of plans."""
    return lambda log, _limits: (float(flags(log).sum()), float(len(log)))


def _plan_violations(commands: Callable[[PlanLog], Array]) -> _PlanRow:
    """Rows for the share of plans that break a bound anywhere, from the last command on."""

    def row(log: PlanLog, limits: ActuatorLimits) -> tuple[float, float]:
        broken = [
            any(map(limits.violated, plan, np.vstack([previous, plan[:-1]])))
            for plan, previous in zip(commands(log), log.previous, strict=True)
        ]
        return float(sum(broken)), float(len(log))

    return row


def _plan_correction(log: PlanLog, limits: ActuatorLimits) -> tuple[float, float]:
    change = limits.to_action(log.actions) - limits.to_action(log.nominal)
    norms = np.linalg.norm(change, axis=2)
    return float(norms.sum()), float(norms.size)


def _plan_energy(column: int) -> _PlanRow:
    """Rows for a mean energy."""

    def row(log: PlanLog, _limits: ActuatorLimits) -> tuple[float, float]:
        known = log.energy[np.isfinite(log.energy[:, column]), column]
        return float(known.sum()), float(len(known))

    return row


def _plan_diversity(log: PlanLog, limits: ActuatorLimits) -> tuple[float, float]:
    count = log.candidates.shape[1]
    if count < 2:
        return 0.0, 0.0
    total = 0.0
    for candidates in log.candidates:
        path = ego_rollout(candidates, limits.wheelbase, limits.dt)
        total += float(pdist(np.column_stack([path.x[:, -1], path.y[:, -1]])).mean())
    return total, float(len(log))


def _jerk(episode: Episode, limits: ActuatorLimits) -> tuple[float, float]:
    jerk = np.diff(episode.speed, n=2) / limits.dt**2
    return float(np.square(jerk).sum()), float(len(jerk))


def _steering_rate(episode: Episode, limits: ActuatorLimits) -> tuple[float, float]:
    change = episode.executed_command[:, 0] - episode.previous_command[:, 0]
    return float(np.square(change / limits.dt).sum()), float(episode.steps)


def _lateral_acceleration(episode: Episode, limits: ActuatorLimits) -> tuple[float]:
    turn = np.diff(episode.pose[:, 2])
    yaw_rate = np.arctan2(np.sin(turn), np.cos(turn)) / limits.dt
    speed = 0.5 * (episode.speed[1:] + episode.speed[:-1])
    return (float(np.abs(speed * yaw_rate).max()),)


METRICS: dict[str, tuple[_Rows, Statistic]] = {
    "success": (_share(lambda e: e.success), ratio),
    "collision_rate": (_share(lambda e: e.collision), ratio),
    "off_road_rate": (_share(lambda e: e.off_road), ratio),
    "timeout_rate": (_share(lambda e: not (e.success or e.collision or e.off_road)), ratio),
    "collisions_per_1k_steps": (_per_step(lambda e: 1000.0 * e.collision), ratio),
    "mean_return": (lambda e, _limits: (e.total_reward, 1.0), ratio),
    "action_similarity": (
        _per_step(lambda e: (1.0 - np.abs(e.agent_action - e.expert_action).mean(1) / 2.0).sum()),
        ratio,
    ),
    "command_violation_rate": (_command_violations, ratio),
    "nominal_violation_rate": (_nominal_violations, ratio),
    **{f"nominal_violation_rate_{s}": (_source(i), ratio) for i, s in enumerate(SOURCES)},
    "intervention_rate": (_per_step(lambda e: e.triggered.sum()), ratio),
    "projection_active_rate": (_per_step(lambda e: e.projected.sum()), ratio),
    "correction_norm": (_correction, ratio),
    "comfort_rms_jerk": (_jerk, root_ratio),
    "comfort_max_lateral_acceleration": (_lateral_acceleration, maximum),
    "comfort_rms_steering_rate": (_steering_rate, root_ratio),
}
"""Name -> (row of one episode, statistic of all rows): the metrics that episodes alone decide."""

PLAN_METRICS: dict[str, _PlanRow] = {
    "plan_projection_rate": _plan_share(lambda log: log.changed),
    "plan_fallback_rate": _plan_share(lambda log: log.fallback),
    "plan_nominal_violation_rate": _plan_violations(lambda log: log.nominal),
    "plan_violation_rate": _plan_violations(lambda log: log.actions),
    "plan_correction_norm": _plan_correction,
    "plan_energy_unguided": _plan_energy(0),
    "plan_energy_nominal": _plan_energy(1),
    "plan_energy": _plan_energy(2),
    "plan_diversity_m": _plan_diversity,
}
"""Name -> row of one log of plans; the statistic is the ratio."""


def _normalized_return(rows: Array) -> Array:
    """Columns: return of the agent, of random actions, of the expert. (B, N, 3) -> (B,)."""
    agent, random, expert = np.moveaxis(rows.mean(axis=1), 1, 0)
    gap = expert - random
    scaled = np.divide(agent - random, gap, out=np.full_like(gap, np.nan), where=gap != 0.0)
    clipped: Array = np.clip(RETURN_SCALE * scaled, 0.0, RETURN_SCALE)
    return clipped


STATISTICS: dict[str, Statistic] = {
    **{name: statistic for name, (_, statistic) in METRICS.items()},
    **{f"{prefix}{name}": ratio for prefix in ("", "state_") for name in PLAN_METRICS},
    "ade_m": ratio,
    "fde_m": ratio,
    "normalized_return": _normalized_return,
    "bc_loss": balanced_mean,
}
"""Name -> statistic of its rows."""


def _return_rows(episodes: Sequence[Episode], references: ReferenceReturns | None) -> Array:
    if references is None:
        return np.empty((0, 3))
    returns = [episode.total_reward for episode in episodes]
    return np.column_stack([returns, references.random, references.expert])


def _held_out_rows(held_out: HeldOutActions | None) -> Array:
    """Per episode and mode: sum of squared errors, then number of states (E, 2 C)."""
    classes = len(Mode)
    if held_out is None:
        return np.empty((0, 2 * classes))
    error = np.square(held_out.agent_action - held_out.expert_action).mean(axis=1)
    episodes, row = np.unique(held_out.seed, return_inverse=True)
    rows = np.zeros((len(episodes), 2 * classes))
    np.add.at(rows, (row, held_out.mode), error)
    np.add.at(rows, (row, held_out.mode + classes), 1.0)
    return rows


def _pairs_rows(distances: Sequence[float]) -> Array:
    return np.column_stack([distances, np.ones(len(distances))])


def latencies(plan: Array, shield: Array) -> dict[str, Value]:
    """Percentiles in milliseconds of all plans and of all shield calls.

    Args:
        plan: Durations of plans (P,) [s].
        shield: Durations of shield calls (T,) [s]; NaN where the shield is off.
    """
    report: dict[str, Value] = {}
    for name, seconds in (("plan", plan), ("shield", shield)):
        measured = 1e3 * seconds[np.isfinite(seconds)]
        for label, percent in (("p50", 50.0), ("p99", 99.0), ("max", 100.0)):
            value = float(np.percentile(measured, percent)) if len(measured) else None
            report[f"latency_{name}_{label}_ms"] = value
    return report
