"""What one finished run contributes to a report: a small JSON file that needs no checkpoint."""

import math
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from irl_dal.cli.threads import one_thread
from irl_dal.config import ConfigError, first_line
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.learning.run_log import read_metrics
from irl_dal.storage.atomic import write_json
from irl_dal.storage.run_folder import RunFolder, read_mapping

FORMAT = 1  # raised whenever this version could misread the files of an older one

CURVES = ("rollout/episode_return", "bc/loss", "rollout/intervention_rate", "rollout/shield_rate")
"""Columns of a run's metrics that a result keeps."""

OVERLAY_SEED = 22_000  # episode whose path is kept, to lay the variants' paths over each other

_ORIGIN = ("commit", "config_hash", "version", "machine", "gradient_threads", "started")


@dataclass(frozen=True, slots=True)
class RunResult:
    """One run, as it is committed under `results/`."""

    variant: str
    seed: int  # of the training
    origin: Mapping[str, Any]
    """Commit, configuration hash, version, machine, threads of a gradient step, start and training
    time [s], and the steps of the first phase."""
    evaluation: Mapping[str, Any]  # flat report of `irl_dal.evaluate`, without the lists of seeds
    first_seed: int  # of the evaluation
    outcomes: Annotated[tuple[bool, ...], Field(min_length=1)]  # success of each of its episodes
    steps: list[int]  # environment steps of the rows of `curves`
    curves: Mapping[str, list[float | None]]  # the columns of `CURVES`; None without a value
    path: list[tuple[float, float]]  # positions (T, 2) [m] on `OVERLAY_SEED`
    arrived: bool  # whether that drive was a success

    @property
    def name(self) -> str:
        """Its file's name without the ending."""
        return f"{self.variant}-seed{self.seed}"

    @property
    def configuration(self) -> str:
        """Hash of the run's configuration; of the evaluation's too where it is another one."""
        hashes = [str(part.get("config_hash")) for part in (self.origin, self.evaluation)]
        return " evaluated as ".join(dict.fromkeys(hashes))

    @property
    def commits(self) -> tuple[str, ...]:
        """Commits of training and evaluation."""
        return tuple(str(part.get("commit")) for part in (self.origin, self.evaluation))

    def score(self, key: str) -> float | None:
        """A metric of the evaluation; None where it was not measured."""
        value = self.evaluation.get(key)
        if value is not None and not isinstance(value, int | float):
            raise ConfigError(f"{self.name}: {key} = {value!r} is not a number")
        return value


_RESULT = TypeAdapter(RunResult)


def summarise_run(folder: RunFolder) -> RunResult | None:
    """A finished run's result; None while the run has no evaluation.

    Raises:
        ConfigError: A file of the run is damaged.
        CheckpointError: It has no checkpoint that can be used.
    """
    if not folder.evaluation.is_file():
        return None
    where = str(folder.path)
    evaluation = read_mapping(folder.evaluation, where)
    started = read_mapping(folder.path / "run.json", where)
    damaged = folder.metrics
    try:
        rows = read_metrics(folder.metrics)
        curves = {name: [_number(row.get(name)) for row in rows] for name in CURVES}
        steps = [int(row["step"]) for row in rows]
        seconds = [value for row in rows if (value := _number(row.get("time/total")))]
        damaged = folder.evaluation
        first_seed = int(evaluation.pop("seeds")[0])
        outcomes = tuple(map(bool, evaluation.pop("episode_success")))
    except (OSError, ValueError, LookupError, TypeError):
        raise ConfigError(f"{damaged}: is damaged") from None
    origin = {key: started.get(key) for key in _ORIGIN}
    origin["training_seconds"] = round(seconds[-1], 1) if seconds else None
    origin["imitation_steps"] = folder.config.learning.imitation_steps
    with one_thread(), closing(Rig.build(folder.config, AgentSpec("run", folder.path))) as rig:
        episode = rig.drive(OVERLAY_SEED)
    path = [(float(x), float(y)) for x, y in np.round(episode.pose[::2, :2], 2)]
    return RunResult(
        variant=folder.config.variant,
        seed=folder.config.seed,
        origin=origin,
        evaluation=evaluation,
        first_seed=first_seed,
        outcomes=outcomes,
        steps=steps,
        curves=curves,
        path=path,
        arrived=episode.success,
    )


def write_result(result: RunResult, path: Path) -> None:
    """Write a result, in one step."""
    write_json(path, {"format": FORMAT, **asdict(result)})


def read_result(path: Path) -> RunResult:
    """Read what `write_result` wrote.

    Raises:
        ConfigError: The file is damaged or of another version.
    """
    content = read_mapping(path, str(path.parent))
    version = content.pop("format", None)
    if version != FORMAT:
        raise ConfigError(f"{path}: result format {version!r}, this version reads {FORMAT}")
    try:
        result = _RESULT.validate_python(content)
    except ValidationError as error:
        raise ConfigError(f"{path}: {first_line(error)[:200]}") from None
    if any(len(column) != len(result.steps) for column in result.curves.values()):
        raise ConfigError(f"{path}: is damaged")
    return result


def _number(text: str | None) -> float | None:
    """A cell of the metrics file; None where it is empty or not finite."""
    value = float(text) if text else math.nan
    return float(f"{value:.5g}") if math.isfinite(value) else None  # enough for a figure
