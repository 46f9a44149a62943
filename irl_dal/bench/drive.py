"""Drives with everything that a benchmark of the city looks at."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from irl_dal.config import RunConfig
from irl_dal.envs import CityConfig
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.workers import Workers

__all__ = ["Drive", "drives", "expert_drives"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Drive:
    """One episode of T steps.

    Attributes:
        seed: Of the episode.
        outcome: success, collision, off_road or timeout.
        brightness: Of its light, 0 dark to 1 bright.
        offset: True lateral offset (T + 1,) [m].
        measured: What the lane sensor said (T + 1,) [m]; NaN where it said nothing.
        tracked: What the tracker made of it (T + 1,) [m].
        valid: Whether the tracker vouched for it (T + 1,).
        violations: Steps on which the driver's own command broke a bound before the shield.
        commands: What was executed (T, 2) [rad, m/s].
    """

    seed: int
    outcome: str
    brightness: float
    offset: Array
    measured: Array
    tracked: Array
    valid: NDArray[np.bool_]
    violations: int
    commands: Array

    @property
    def steps(self) -> int:
        """Number of control steps T."""
        return len(self.commands)


def expert_drives(config: CityConfig, seeds: Iterable[int]) -> Iterator[Drive]:
    """Let the expert drive under its shield, one episode for each seed, in this process.

    On a track the n-th episode takes the n-th stretch.
    """
    rig = Rig.build(replace(RunConfig(), env=config), AgentSpec("expert"))
    try:
        for task in enumerate(seeds):
            yield _drive(rig, task)
    finally:
        rig.close()


def drives(
    config: RunConfig,
    spec: AgentSpec,
    seeds: Sequence[int],
    *,
    jobs: int,
    what: str,
    console: Console,
) -> list[Drive]:
    """Let an agent drive, one episode for each seed, in several processes.

    Args:
        config: The city and, for a trained run, everything else.
        spec: Who drives.
        seeds: Of the episodes.
        jobs: Number of processes.
        what: Name in front of the progress bar.
        console: Where it goes.

    Raises:
        CheckpointError: The run has no checkpoint that can be used.
    """
    with Workers(config, spec, jobs, console) as workers:
        return workers.map(what, _drive, list(enumerate(seeds)))


def _drive(rig: Rig, task: tuple[int, int]) -> Drive:
    number, seed = task
    loop, agent = rig.loop, rig.agent
    observation, info = loop.reset(seed=seed, options={"stretch": number})
    agent.reset(seed)
    rows, commands, violations, over = [_row(info)], [], 0, False
    while not over:
        action = agent.act(observation, info)
        observation, _, terminated, truncated, info = agent.drive(loop, action)
        rows.append(_row(info))
        commands.append(info["executed_command"])
        own = info["nominal_violations"]
        violations += own.get("expert", own.get("policy", False))
        over = terminated or truncated
    values = np.array(rows, np.float64)
    ends = (name for name in ("success", "collision", "off_road") if info[name])
    return Drive(
        seed=seed,
        outcome=next(ends, "timeout"),
        brightness=loop.city.brightness,
        offset=values[:, 0],
        measured=values[:, 1],
        tracked=values[:, 2],
        valid=values[:, 3] > 0.0,
        violations=violations,
        commands=np.array(commands),
    )


def _row(info: Mapping[str, Any]) -> tuple[float, float, float, float]:
    measurement, lane = info["lane_measurement"], info["lane"]
    seen = float("nan") if measurement is None else measurement.lateral_offset
    return info["lateral_offset"], seen, lane.lateral_offset, lane.valid
