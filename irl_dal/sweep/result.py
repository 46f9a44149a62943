"""What one finished run contributes to a report: a small JSON file that needs no checkpoint."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from expert.modes import Mode
from irl_dal.cli.threads import one_thread
from irl_dal.config import ConfigError
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.learning.run_log import read_metrics
from irl_dal.storage.atomic import write_json
from irl_dal.storage.run_folder import RunFolder

__all__ = [
    "CURVES",
    "OVERLAY_SEED",
    "REPLAY",
    "RunResult",
    "read_result",
    "summarise_run",
    "write_result",
]

FORMAT = 1
"""Raised whenever this version could misread the files of an older one."""

REPLAY = {mode: f"replay/{mode.name.lower()}" for mode in Mode}
"""Columns with the transitions that the replay buffer holds of each state of the expert."""

CURVES = (
    "rollout/episode_return",
    "bc/loss",
    "rollout/intervention_rate",
    "rollout/shield_rate",
    *REPLAY.values(),
)
"""Columns of a run's metrics that a result keeps."""

OVERLAY_SEED = 22_000
"""Episode whose path is kept, to lay the variants' paths over each other."""

_DIGITS = 5


@dataclass(frozen=True, slots=True)
class RunResult:
    """One run, as it is committed under `results/`.

    Attributes:
        variant: Which variant was trained.
        seed: Of the training.
        origin: Commit, configuration hash, version, machine, threads of a gradient step, start and
            training time [s], and the steps of the first phase.
        evaluation: Flat report of its evaluation, as `irl_dal.evaluate` writes it, without the
            lists of seeds.
        first_seed: Of the evaluation.
        outcomes: Success of each evaluation episode.
        steps: Environment steps of the rows of `curves`.
        curves: The columns of `CURVES`; None where a row has no value.
        path: Positions (T, 2) [m] on `OVERLAY_SEED`.
        arrived: Whether that drive was a success.
    """

    variant: str
    seed: int
    origin: Mapping[str, Any]
    evaluation: Mapping[str, Any]
    first_seed: int
    outcomes: tuple[bool, ...]
    steps: list[int]
    curves: Mapping[str, list[float | None]]
    path: list[list[float]]
    arrived: bool

    @property
    def name(self) -> str:
        """Its file's name without the ending."""
        return f"{self.variant}-seed{self.seed}"


def summarise_run(folder: RunFolder) -> RunResult | None:
    """A finished run's result; None while the run has no evaluation.

    Raises:
        ConfigError: A file of the run is damaged.
        CheckpointError: It has no checkpoint that can be used.
    """
    if not folder.evaluation.is_file():
        return None
    report = _read(folder.evaluation)
    started = _read(folder.path / "run.json")
    rows = read_metrics(folder.metrics)
    seconds = [float(row["time/total"]) for row in rows if row.get("time/total")]
    kept = ("commit", "config_hash", "version", "machine", "gradient_threads", "started")
    path, arrived = _overlay(folder)
    return RunResult(
        variant=folder.config.variant,
        seed=folder.config.seed,
        origin={key: started.get(key) for key in kept}
        | {
            "training_seconds": round(seconds[-1], 1) if seconds else None,
            "imitation_steps": folder.config.learning.imitation_steps,
        },
        evaluation={k: v for k, v in report.items() if k not in ("seeds", "episode_success")},
        first_seed=int(report["seeds"][0]),
        outcomes=tuple(bool(one) for one in report["episode_success"]),
        steps=[int(row["step"]) for row in rows],
        curves={name: [_number(row.get(name)) for row in rows] for name in CURVES},
        path=path,
        arrived=arrived,
    )


def write_result(result: RunResult, path: Path) -> None:
    """Write a result, in one step."""
    write_json(path, {"format": FORMAT, **asdict(result)})


def read_result(path: Path) -> RunResult:
    """Read what `write_result` wrote.

    Raises:
        ConfigError: The file is damaged or of another version.
    """
    content = _read(path)
    found = content.pop("format", None)
    if found != FORMAT:
        raise ConfigError(f"{path}: result format {found!r}, this version reads {FORMAT}")
    try:
        return RunResult(**content | {"outcomes": tuple(content["outcomes"])})
    except (KeyError, TypeError):
        raise ConfigError(f"{path}: is not the result of a run") from None


def _overlay(folder: RunFolder) -> tuple[list[list[float]], bool]:
    """Drive the one episode whose path is kept."""
    with one_thread():
        bench = Rig.build(folder.config, AgentSpec("run", folder.path))
        try:
            episode = bench.drive(OVERLAY_SEED)
        finally:
            bench.close()
    return np.round(episode.pose[::2, :2], 2).tolist(), episode.success


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: is missing") from None
    except ValueError:
        raise ConfigError(f"{path}: is damaged") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: is damaged")
    return content


def _number(text: str | None) -> float | None:
    """A cell of the metrics file; None where it is empty or not finite."""
    value = float(text) if text else math.nan
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
