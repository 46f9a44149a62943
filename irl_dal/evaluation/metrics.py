"""Every number that the project reports, from logged drives and nothing else.

Shares are fractions. `<key>_ci95` is the 95 % bootstrap interval [low, high] over episodes, for
`ade_m` and `fde_m` over the compared stretches. What could not be measured is null.

* `success`: share of episodes with the goal reached, no collision, never off the road, in time;
  `collision_rate`, `off_road_rate`, `timeout_rate`: share of episodes with that flaw;
  `episode_success`: the same per episode, in the order of `seeds`.
* `at_fault_rate`: share of episodes in which the car touched something or left its lanes, and
  neither standing, nor a hit from behind, nor a broken assumption excuses it
  (`irl_dal.envs.attribution`); `departure_rate`: share in which a corner of its body was beyond the
  edges of its own two lanes, regardless of fault.
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
* `mean_speed`: true speed, mean over steps [m/s].
* `correction_norm`: mean norm of executed minus nominal action, normalised units.
* `comfort_rms_jerk` [m/s^3]: of the true motion, along and across the road together (change of the
  speed, speed times yaw rate), low-passed at 2 Hz (Butterworth, second order, without a phase).
  UN R79 judges lateral jerk below 0.5 Hz, ISO 22179 braking as a mean over 1 s, both less strict.
  `comfort_harsh_rate`: share of steps with more than 6 m/s^3.
  `comfort_max_lateral_acceleration` [m/s^2] (true speed times true yaw rate),
  `comfort_rms_steering_rate` [rad/s] (of the executed command).
* `latency_plan_*_ms`, `latency_shield_*_ms`: p50, p99 and max of one plan and of one shield call.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.distance import pdist

from expert import Mode
from irl_dal.evaluation import statistics
from irl_dal.evaluation.episode import Episode, LoggedPlan
from irl_dal.evaluation.statistics import Array, Estimate, Statistic, estimate, ratio
from irl_dal.loop import SOURCES
from irl_dal.planner.rollout import ego_rollout
from shield import ActuatorLimits, Status

Value = float | int | str | list[float] | list[int] | list[bool] | None
"""An entry of the flat report."""

Row = Sequence[float]
"""What one episode, one log of plans or one path contributes to a statistic: (K,)."""

_EpisodeRow = Callable[[Episode, ActuatorLimits], Row]

_PlanRow = Callable[[Sequence[LoggedPlan], ActuatorLimits], Row]

RETURN_SCALE = 200.0  # the expert's normalised return

COMFORT_BANDWIDTH = 2.0  # [Hz] of the jerk that counts; sampling and suspension lie above

HARSH = 6.0  # [m/s^3] comfortable driving stays below 2, emergency braking begins at about 10

ENERGIES = ("energy_unguided", "energy_nominal", "energy")


def compute_metrics(
    episodes: Sequence[Mapping[str, Any]],
    rng: np.random.Generator,
    *,
    references: Sequence[Row] = (),
    cloning: Sequence[Row] = (),
    distances: Sequence[Row] = (),
) -> dict[str, Value]:
    """All numbers of an evaluation under their names, flat, ready for JSON.

    Args:
        episodes: `episode_record` of each of the agent's N episodes.
        rng: Of the bootstrap.
        references: Returns of random actions and of the expert on the same seeds (N, 2), if known.
        cloning: `cloning_row` of each held-out expert episode.
        distances: Between the agent's and the expert's path, one (K,) [m] per stretch.
    """
    if not episodes:
        raise ValueError("`episodes` must hold at least one episode. Got 0.")
    report: dict[str, Value] = {
        "episodes": len(episodes),
        "steps": sum(episode["steps"] for episode in episodes),
        "seeds": [episode["seed"] for episode in episodes],
        "episode_success": [episode["success"] for episode in episodes],
    }
    rows = join_rows(episode["rows"] for episode in episodes)
    rows |= join_rows([path_rows(distances), {"bc_loss": cloning}])
    if references:
        returns = [episode["return"] for episode in episodes]
        rows["normalized_return"] = np.column_stack([returns, references])
    for name, statistic in STATISTICS.items():
        result = estimate(rows[name], statistic, rng) if name in rows else Estimate()
        report |= result.entries(name)
    return report | latencies(episodes)


def episode_record(episode: Episode, limits: ActuatorLimits) -> dict[str, Any]:
    """What is kept of an episode: all that its numbers are made of, ready for JSON.

    Records of several evaluations can be joined: `STATISTICS[name]` of all rows is the number.
    """
    rows = {name: [_floats(row(episode, limits))] for name, row in METRICS.items()}
    shield = episode.shield_time[np.isfinite(episode.shield_time)]
    return {
        "seed": episode.seed,
        "steps": episode.steps,
        "success": episode.success,
        "return": episode.total_reward,
        "triggered": int(episode.triggered.sum()),
        "rows": rows | plan_rows(episode.plans, limits),
        "plan_seconds": [round(entry.plan.latency, 7) for entry in episode.plans],
        "shield_seconds": np.round(shield, 7).tolist(),
    }


def plan_rows(
    plans: Sequence[LoggedPlan], limits: ActuatorLimits, prefix: str = ""
) -> dict[str, list[Row]]:
    """Rows of the plans of one episode, or of one set of states."""
    return {prefix + name: [_floats(row(plans, limits))] for name, row in PLAN_METRICS.items()}


def path_rows(distances: Sequence[Row | Array]) -> dict[str, list[Row]]:
    """Rows of stretches from their distances, each (K,) [m]."""
    return {
        "ade_m": [(float(np.mean(stretch)), 1.0) for stretch in distances],
        "fde_m": [(float(stretch[-1]), 1.0) for stretch in distances],
    }


def cloning_row(episode: Episode, answers: Array) -> list[float]:
    """Squared errors of an agent in an expert's episode, summed per mode, then counted (2 C,).

    `answers` are the agent's actions in its states (T, 2), normalised.
    """
    error = np.square(answers - episode.expert_action).mean(axis=1)
    weights = (error, np.ones_like(error))
    return [float(s) for each in weights for s in np.bincount(episode.mode, each, len(Mode))]


def join_rows(entries: Iterable[Mapping[str, Sequence[Row]]]) -> dict[str, Array]:
    """Rows of the same name, one under the other (N, K); names without a row are left out."""
    joined: dict[str, list[Row]] = {}
    for entry in entries:
        for name, rows in entry.items():
            joined.setdefault(name, []).extend(rows)
    return {name: np.array(rows, np.float64) for name, rows in joined.items() if rows}


def latencies(records: Sequence[Mapping[str, Any]]) -> dict[str, Value]:
    """Percentiles in milliseconds of all plans and of all shield calls of some records."""
    report: dict[str, Value] = {}
    for name in ("plan", "shield"):
        measured = [1e3 * seconds for r in records for seconds in r[f"{name}_seconds"]]
        for label, percent in (("p50", 50.0), ("p99", 99.0), ("max", 100.0)):
            value = float(np.percentile(measured, percent)) if measured else None
            report[f"latency_{name}_{label}_ms"] = value
    return report


def _floats(row: Row) -> Row:
    return tuple(map(float, row))


def _total(values: ArrayLike) -> Row:
    """Sum and number of values: `ratio` of such rows is the mean of all values."""
    table = np.asarray(values, np.float64)
    return table.sum(), table.size


def _broken(commands: Array, previous: Array, limits: ActuatorLimits) -> list[bool]:
    """Which of some commands (T, 2) break a bound."""
    return list(map(limits.violated, commands, previous))


def _change(after: Array, before: Array, limits: ActuatorLimits) -> Array:
    """Norms of differences of commands in normalised units (T,)."""
    return np.linalg.norm(limits.to_action(after) - limits.to_action(before), axis=-1)


def _source(column: int) -> _EpisodeRow:
    """Rows for the share of a source's proposals that broke a bound."""

    def row(episode: Episode, _: ActuatorLimits) -> Row:
        spoken = episode.nominal_violations[:, column]
        return (spoken == 1).sum(), (spoken >= 0).sum()

    return row


def _jerk(episode: Episode, limits: ActuatorLimits) -> Array:
    """Size of the low-passed jerk between steps (T - 1,) [m/s^3]."""
    braking = np.diff(episode.speed) / limits.dt
    acceleration = np.stack([braking, _cornering(episode, limits)])
    rate = 1.0 / limits.dt
    low_pass = butter(2, min(COMFORT_BANDWIDTH, 0.49 * rate), fs=rate, output="sos")
    padding = min(9, len(braking) - 1)
    felt = sosfiltfilt(low_pass, acceleration, axis=1, padlen=padding)
    return np.asarray(np.hypot(*np.diff(felt, axis=1)) / limits.dt)


def _steering_rate(episode: Episode, limits: ActuatorLimits) -> Row:
    change = episode.executed_command[:, 0] - episode.previous_command[:, 0]
    return _total(np.square(change / limits.dt))


def _cornering(episode: Episode, limits: ActuatorLimits) -> Array:
    """Lateral acceleration in each step (T,) [m/s^2]."""
    turn = np.diff(episode.pose[:, 2])
    yaw_rate = np.arctan2(np.sin(turn), np.cos(turn)) / limits.dt
    return np.asarray(0.5 * (episode.speed[1:] + episode.speed[:-1]) * yaw_rate)


METRICS: dict[str, _EpisodeRow] = {
    "success": lambda e, _: (e.success, 1),
    "collision_rate": lambda e, _: (e.collision, 1),
    "off_road_rate": lambda e, _: (e.off_road, 1),
    "at_fault_rate": lambda e, _: (e.at_fault, 1),
    "departure_rate": lambda e, _: (e.departed, 1),
    "timeout_rate": lambda e, _: (not (e.success or e.collision or e.off_road), 1),
    "collisions_per_1k_steps": lambda e, _: (1000 * e.collision, e.steps),
    "mean_return": lambda e, _: (e.total_reward, 1),
    "action_similarity": lambda e, _: _total(
        1.0 - np.abs(e.agent_action - e.expert_action).mean(1) / 2.0
    ),
    "command_violation_rate": lambda e, limits: _total(
        _broken(e.executed_command, e.previous_command, limits)
    ),
    "nominal_violation_rate": lambda e, limits: _total(
        _broken(e.nominal_command, e.previous_command, limits)
    ),
    **{f"nominal_violation_rate_{source}": _source(i) for i, source in enumerate(SOURCES)},
    "intervention_rate": lambda e, _: _total(e.triggered),
    "projection_active_rate": lambda e, _: _total(e.projected),
    "correction_norm": lambda e, limits: _total(
        _change(e.executed_command, e.nominal_command, limits)
    ),
    "mean_speed": lambda e, _: _total(e.speed[1:]),
    "comfort_rms_jerk": lambda e, limits: _total(np.square(_jerk(e, limits))),
    "comfort_harsh_rate": lambda e, limits: _total(_jerk(e, limits) > HARSH),
    "comfort_max_lateral_acceleration": lambda e, limits: (np.abs(_cornering(e, limits)).max(),),
    "comfort_rms_steering_rate": _steering_rate,
}
"""Name -> row of one episode: the metrics that episodes alone decide."""


def _plan_violations(name: str) -> _PlanRow:
    """Rows for the share of plans that break a bound anywhere, from the last command on."""

    def row(plans: Sequence[LoggedPlan], limits: ActuatorLimits) -> Row:
        both = [(getattr(plan, name), previous) for plan, previous in plans]
        before = [np.vstack([previous, commands[:-1]]) for commands, previous in both]
        pairs = zip(both, before, strict=True)
        return _total([any(_broken(commands, last, limits)) for (commands, _), last in pairs])

    return row


def _plan_correction(plans: Sequence[LoggedPlan], limits: ActuatorLimits) -> Row:
    return _total([_change(plan.actions, plan.nominal, limits) for plan, _ in plans])


def _plan_energy(name: str) -> _PlanRow:
    """Rows for a mean energy, fallbacks left out."""

    def row(plans: Sequence[LoggedPlan], _: ActuatorLimits) -> Row:
        values = np.array([getattr(entry.plan, name) for entry in plans], np.float64)
        return _total(values[np.isfinite(values)])

    return row


def _plan_diversity(plans: Sequence[LoggedPlan], limits: ActuatorLimits) -> Row:
    """A fallback has one candidate: no distance. Plans of one candidate each have no row."""
    if all(len(entry.plan.candidates) < 2 for entry in plans):
        return 0.0, 0.0
    total = 0.0
    for plan, _ in plans:
        path = ego_rollout(plan.candidates, limits.wheelbase, limits.dt)
        ends = np.column_stack([path.x[:, -1], path.y[:, -1]])
        total += float(pdist(ends).mean()) if len(ends) > 1 else 0.0
    return total, len(plans)


PLAN_METRICS: dict[str, _PlanRow] = {
    "plan_projection_rate": lambda plans, _: _total([p.status != Status.NOMINAL for p, _ in plans]),
    "plan_fallback_rate": lambda plans, _: _total([p.status == Status.FALLBACK for p, _ in plans]),
    "plan_nominal_violation_rate": _plan_violations("nominal"),
    "plan_violation_rate": _plan_violations("actions"),
    "plan_correction_norm": _plan_correction,
    **{f"plan_{name}": _plan_energy(name) for name in ENERGIES},
    "plan_diversity_m": _plan_diversity,
}
"""Name -> row of the plans of an episode or of a set of states."""


def _normalized_return(rows: Array) -> Array:
    """Columns: return of the agent, of random actions, of the expert. (B, N, 3) -> (B,)."""
    agent, random, expert = np.moveaxis(rows.mean(axis=1), 1, 0)
    scaled = statistics.divide(agent - random, expert - random)
    return np.asarray(np.clip(RETURN_SCALE * scaled, 0.0, RETURN_SCALE))


STATISTICS: dict[str, Statistic] = {
    **dict.fromkeys([*METRICS, *PLAN_METRICS, *(f"state_{name}" for name in PLAN_METRICS)], ratio),
    "comfort_rms_jerk": statistics.root_ratio,
    "comfort_max_lateral_acceleration": statistics.maximum,
    "comfort_rms_steering_rate": statistics.root_ratio,
    "ade_m": ratio,
    "fde_m": ratio,
    "normalized_return": _normalized_return,
    "bc_loss": statistics.balanced_mean,
}
"""Name -> statistic of its rows, in the order in which the bootstrap draws."""
