"""Drives for the benchmarks of the city: how they end, and the lane measurement in them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from irl_dal.config import RunConfig
from irl_dal.envs import CityConfig
from irl_dal.evaluation.metrics import METRICS, STATISTICS, Row
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.rollout import drive_episode
from irl_dal.evaluation.statistics import Array
from irl_dal.evaluation.workers import Workers
from irl_dal.figures.table import terminal_table
from irl_dal.loop import Observation

# Metrics of a drive's speed [m/s], jerk [m/s³] and steering rate [rad/s], and of the shield's share
RIDE = {
    "speed": "mean_speed",
    "jerk": "comfort_rms_jerk",
    "harsh": "comfort_harsh_rate",
    "steering": "comfort_rms_steering_rate",
    "changed": "projection_active_rate",
}


@dataclass(frozen=True, slots=True)
class Drive:
    """One episode of T steps."""

    outcome: str  # success, collision, off_road or timeout
    brightness: float  # of its light, 0 dark to 1 bright
    offset: Array  # true lateral offset (T + 1,) [m]
    measured: Array  # by the lane sensor (T + 1,) [m]; NaN without a measurement
    tracked: Array  # by the tracker (T + 1,) [m]
    valid: NDArray[np.bool_]  # whether the tracker calls its estimate valid (T + 1,)
    commands: Array  # executed (T, 2) [rad, m/s]
    ride: tuple[Row, ...]  # of each metric of `RIDE`


def expert_drives(city: CityConfig, seeds: Sequence[int]) -> list[Drive]:
    """Let the expert drive under its shield, one episode for each seed, in this process."""
    return drives(replace(RunConfig(), env=city), AgentSpec("expert"), seeds)


def drives(
    config: RunConfig,
    spec: AgentSpec,
    seeds: Sequence[int],
    jobs: int = 1,
    what: str = "",
    console: Console | None = None,
) -> list[Drive]:
    """Let an agent drive, one episode for each seed, in `jobs` processes.

    On a track the n-th episode takes the n-th stretch.
    """
    return Workers(config, spec, jobs, console).map(what, _drive, list(enumerate(seeds)))


def outcome_table(title: str, groups: Mapping[str, Sequence[Drive]]) -> Table:
    """Success and its opposites, and the ride."""
    ends = ("success", "collision", "off_road", "timeout")
    rows = []
    for name, group in groups.items():
        count = Counter(drive.outcome for drive in group)
        shares = [f"{count[end] / len(group):.1%}" for end in ends]
        ride = [
            f"{STATISTICS[metric](np.array([[drive.ride[place] for drive in group]]))[0]:.3f}"
            for place, metric in enumerate(RIDE.values())
        ]
        rows.append([name, str(len(group)), *shares, *ride])
    return terminal_table(title, ["", "episodes", *ends, *RIDE], rows)


def _drive(rig: Rig, task: tuple[int, int]) -> Drive:
    number, seed = task
    rows: list[tuple[float, float, float, float]] = []

    def watch(_: Observation, info: Mapping[str, Any]) -> None:
        measurement, lane = info["lane_measurement"], info["lane"]
        measured = np.nan if measurement is None else measurement.lateral_offset
        rows.append((info["lateral_offset"], measured, lane.lateral_offset, lane.valid))

    episode = drive_episode(rig.loop, rig.agent, seed, watch, {"stretch": number})
    offset, measured, tracked, valid = np.array(rows, np.float64).T
    ends = (name for name in ("success", "collision", "off_road") if getattr(episode, name))
    return Drive(
        next(ends, "timeout"), rig.loop.city.brightness, offset, measured, tracked, valid > 0.0,
        episode.executed_command,
        tuple(METRICS[name](episode, rig.loop.limits) for name in RIDE.values()),
    )  # fmt: skip


DAY = 0.5  # brightness from which it is day
WRONG = 0.8  # [m] error beyond which a valid estimate is confidently wrong

_FORMATS = {
    "episodes": "{:.0f}",
    "RMSE measured [m]": "{:.3f}",
    "RMSE after tracking [m]": "{:.3f}",
    "steps with a measurement": "{:.2%}",
    "steps with a valid estimate": "{:.2%}",
    "confidently wrong": "{:.3%}",
}


def lane_numbers(drives: Sequence[Drive]) -> dict[str, float]:
    """RMSE of the lateral offset, validity, and how often a valid one errs by more than `WRONG`."""
    offset = np.concatenate([drive.offset for drive in drives])
    measured = np.concatenate([drive.measured for drive in drives]) - offset
    tracked = np.concatenate([drive.tracked for drive in drives]) - offset
    valid = np.concatenate([drive.valid for drive in drives])
    seen = np.isfinite(measured)
    wrong = valid & (np.abs(tracked) > WRONG)
    rmse = (float(np.sqrt(np.mean(error**2))) for error in (measured[seen], tracked[valid]))
    shares = (float(share.mean()) for share in (seen, valid, wrong))
    return dict(zip(_FORMATS, (float(len(drives)), *rmse, *shares), strict=True))


def lane_table(drives: Sequence[Drive]) -> Table:
    """The numbers by day, in the dark and together."""
    groups = {
        "day": [drive for drive in drives if drive.brightness >= DAY],
        "dark": [drive for drive in drives if drive.brightness < DAY],
        "all": list(drives),
    }
    columns = {name: lane_numbers(group) for name, group in groups.items() if group}
    rows = [
        [title, *(form.format(numbers[title]) for numbers in columns.values())]
        for title, form in _FORMATS.items()
    ]
    return terminal_table("lateral offset against the truth", ["", *columns], rows)
