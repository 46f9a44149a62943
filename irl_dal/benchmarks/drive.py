"""Expert drives with everything that a benchmark of the city looks at."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from expert import ExpertConfig, FSMExpert
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.loop import ControlLoop, Supervision
from shield import SafetyFilter, TriggerConfig

__all__ = ["Drive", "expert_drives"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Drive:
    """One expert episode of T steps.

    Attributes:
        seed: Of the episode.
        outcome: success, collision, off_road or timeout.
        brightness: Of its light, 0 dark to 1 bright.
        offset: True lateral offset (T + 1,) [m].
        measured: What the lane sensor said (T + 1,) [m]; NaN where it said nothing.
        tracked: What the tracker made of it (T + 1,) [m].
        valid: Whether the tracker vouched for it (T + 1,).
        violations: Steps on which the expert's own command broke a bound.
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
    """Let the expert drive under its shield, one episode for each seed.

    On a track the n-th episode takes the n-th stretch.
    """
    env = CityEnv(config)
    expert = FSMExpert(ExpertConfig(max_range=config.lidar_range), env.limits)
    watch = Supervision(safety_filter=SafetyFilter(env.limits))
    loop = ControlLoop(env, expert, watch, TriggerConfig())
    try:
        for number, seed in enumerate(seeds):
            yield _drive(loop, seed, number)
    finally:
        loop.close()


def _drive(loop: ControlLoop, seed: int, number: int) -> Drive:
    _, info = loop.reset(seed=seed, options={"stretch": number})
    rows, commands, violations, over = [_row(info)], [], 0, False
    while not over:
        _, _, terminated, truncated, info = loop.step_expert()
        rows.append(_row(info))
        commands.append(info["executed_command"])
        violations += info["nominal_violations"]["expert"]
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


def _row(info: dict[str, object]) -> tuple[float, float, float, float]:
    measurement, lane = info["lane_measurement"], info["lane"]
    seen = float("nan") if measurement is None else measurement.lateral_offset  # type: ignore[attr-defined]
    return info["lateral_offset"], seen, lane.lateral_offset, lane.valid  # type: ignore[attr-defined, return-value]
