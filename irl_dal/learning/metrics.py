"""Metrics on disk: `metrics.csv` and TensorBoard, through stable-baselines3's logger."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

__all__ = ["MetricsCsv", "metrics_logger"]

FIRST_COLUMN = "step"


class MetricsCsv(KVWriter):
    """One row per dump, the environment step first, a new column whenever a new key turns up.

    What lies in the file from an earlier part of the run is kept up to `step`: rows of an interval
    that was lost, or half a row that a killed process left, are removed. Every rewrite is atomic.

    Args:
        path: The CSV file.
        step: Step at which the run goes on.
    """

    def __init__(self, path: Path, step: int = 0) -> None:
        self.path = path
        self._columns, rows = _read(path)
        self._rewrite([row for row in rows if int(row[FIRST_COLUMN]) <= step] if step else [])

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        """Append a row."""
        row = {FIRST_COLUMN: step} | {
            key: value for key, value in key_values.items() if "csv" not in key_excluded[key]
        }
        new = sorted(row.keys() - set(self._columns))
        if new:
            self._columns += new
            self._rewrite(_read(self.path)[1])
        with self.path.open("a", newline="") as file:
            csv.DictWriter(file, self._columns, restval="").writerow(row)

    def close(self) -> None:
        """Nothing is held open between two rows."""

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        hidden = self.path.with_name(f".{self.path.name}.part")
        with hidden.open("w", newline="") as file:
            writer = csv.DictWriter(file, self._columns, restval="")
            writer.writeheader()
            writer.writerows(rows)
            file.flush()
            os.fsync(file.fileno())
        hidden.replace(self.path)


def metrics_logger(run_dir: Path, step: int = 0) -> Logger:
    """A logger that writes `metrics.csv` and TensorBoard events of a run.

    Args:
        run_dir: Run folder.
        step: Step at which the run goes on; what was written after it is dropped.
    """
    run_dir.mkdir(parents=True, exist_ok=True)
    board = TensorBoardOutputFormat(str(run_dir / "tensorboard"))
    if step:
        board.writer.close()
        board.writer = SummaryWriter(str(run_dir / "tensorboard"), purge_step=step + 1)
    return Logger(str(run_dir), [MetricsCsv(run_dir / "metrics.csv", step), board])


def read_metrics(path: Path) -> list[Mapping[str, str]]:
    """All rows of a metrics file; empty strings where a row has no value."""
    return list(_read(path)[1])


def _read(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Columns and complete rows."""
    if not path.is_file():
        return [FIRST_COLUMN], []
    text = path.read_text()
    # A row without its line end is one that a killed process did not finish.
    lines = text[: text.rfind("\n") + 1].splitlines()
    if not lines:
        return [FIRST_COLUMN], []
    reader = csv.DictReader(lines)
    columns = list(reader.fieldnames or [FIRST_COLUMN])
    rows = [row for row in reader if row[FIRST_COLUMN].isdecimal()]
    return columns, rows
