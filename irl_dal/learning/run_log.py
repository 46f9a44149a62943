"""The log of a training run: rows of metrics (CSV, TensorBoard), timings, and the progress bar.

Columns of `metrics.csv`; a cell is empty where the row has no new value.

| column | meaning |
|---|---|
| `step`, `phase` | environment steps so far; 1 imitation, 2 mixed |
| `rollout/env_reward` | mean environment reward per step since the last row |
| `rollout/episode_return`, `rollout/success_rate` | means over the newest 20 episodes |
| `rollout/intervention_rate` | share of steps since the last row with the planner triggered |
| `rollout/shield_rate` | share of steps since the last row with the command changed by the shield |
| `rollout/action_similarity` | 1 - mean abs(a_pi - a*) / 2 since the last row, with exploration |
| `bc/train_loss`, `bc/loss`, `bc/loss_<mode>` | training with L2; held out, all modes and each |
| `mask/alpha_speed`, `mask/alpha_lidar` | the adaptive mask's parameters |
| `planner/train_loss`, `planner/loss` | denoising loss, training and held out |
| `discriminator/loss`, `/accuracy`, `/expert_logit`, `/agent_logit` | of the newest update |
| `reward/env`, `reward/imitation`, `reward/failures` | r_env, r_irl, failures per rollout |
| `train/...` | stable-baselines3's own |
| `count/...` | what happened so far: see `Counts`; `count/saec_marks` |
| `replay/<mode>` | transitions in each partition |
| `time/total`, `time/<part>`, `time/steps_per_second` | seconds so far; speed since the last row |
"""

import csv
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from io import StringIO
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from irl_dal.learning.collection.recorder import Counts, Recorder
from irl_dal.storage.atomic import write_text

STEP = "step"  # first column of the metrics
LINE = 4  # rows of metrics to a line where there is no terminal
OTHER = "other"  # part of a run's time that no other part claims
SHOWN = {  # key metrics of the bar, in this order
    "time/steps_per_second": "{:.0f} steps/s",
    "rollout/success_rate": "success {:.0%}",
    "rollout/episode_return": "return {:.0f}",
    "bc/loss": "BC {:.4f}",
    "planner/loss": "planner {:.3f}",
    "rollout/intervention_rate": "planner on {:.1%}",
    "discriminator/accuracy": "D {:.0%}",
    "count/command_violations": "violations {:.0f}",
}


class ProgressBar:
    """Phase, bar, time left and key metrics; without a terminal, a line for every `LINE` rows."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._shown: dict[str, float] = {}
        self._rows = self._last = 0
        self._phase = ""
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[metrics]}"),
            console=self.console,
            refresh_per_second=4,
            disable=not self.console.is_terminal,
        )
        self._task = self._bar.add_task("", total=None, metrics="")

    def begin(self, phase: str, step: int, last: int) -> None:
        """Show the phase."""
        self._phase, self._last = phase, last
        if not self.console.is_terminal:
            self.console.print(f"{phase}: {step} of {last} steps")
        self._bar.start()
        self._bar.reset(self._task, description=phase, completed=step, total=last)

    def advance(self, step: int) -> None:
        """Move the bar."""
        self._bar.update(self._task, completed=step)

    def metrics(self, step: int, values: Mapping[str, float]) -> None:
        """Show the newest of the key metrics."""
        self._shown |= {key: float(value) for key, value in values.items() if key in SHOWN}
        self._rows += 1
        if not self.console.is_terminal and self._rows % LINE:
            return
        text = "  ".join(
            form.format(self._shown[k]) for k, form in SHOWN.items() if k in self._shown
        )
        self._bar.update(self._task, metrics=text)
        if not self.console.is_terminal:
            self.console.print(f"{self._phase}  {step}/{self._last}  {text}")

    def end(self) -> None:
        """Take the bar away."""
        self._bar.stop()


class RunLog:
    """Writes the rows of what the recorder counts, and shows them."""

    def __init__(self, run_dir: Path, recorder: Recorder, progress: ProgressBar | None) -> None:
        self.seconds: dict[str, float] = {"total": 0.0}  # so far, all of it and by part
        self._run_dir = run_dir
        self._recorder = recorder
        self.progress = progress or ProgressBar(Console(quiet=True, force_terminal=False))
        self._counts = Counts()
        self._row_at = self._started = self._switched = time.monotonic()
        self._part = OTHER
        self._logger: Logger | None = None

    def open(self, step: int) -> Logger:
        """Go on writing after `step`; gives the logger that PPO and the learners record into."""
        self._logger = metrics_logger(self._run_dir, step)
        self._counts = self._recorder.counts
        self._row_at = self._switched = time.monotonic()
        self._started = self._row_at - self.seconds["total"]
        return self._logger

    def close(self) -> None:
        """No more rows."""
        if self._logger is not None:
            self._logger.close()
        self.progress.end()

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Count the time of a block to a part, and not to the part around it."""
        outer = self.switch(part)
        try:
            yield
        finally:
            self.switch(outer)

    def switch(self, part: str) -> str:
        """Count the time from now on to a part; gives the part until now."""
        now, before = time.monotonic(), self._part
        self.seconds[before] = self.seconds.get(before, 0.0) + now - self._switched
        self._part, self._switched = part, now
        return before

    def row(self, step: int, phase: int, more: Mapping[str, float]) -> None:
        """Write a row: what was recorded since the last one, rates, counts and `more`."""
        assert self._logger is not None, "`open` comes first"
        self.switch(self._part)
        now = self._switched
        self.seconds["total"] = now - self._started
        values = {"phase": float(phase)} | self._rates(phase, now) | self._totals() | dict(more)
        for name, value in values.items():
            self._logger.record(name, value)
        written = dict(self._logger.name_to_value)
        self._logger.dump(step)
        self._counts, self._row_at = self._recorder.counts, now
        self.progress.metrics(step, written)

    def _rates(self, phase: int, now: float) -> dict[str, float]:
        added = self._recorder.counts - self._counts
        steps = max(added.steps, 1)
        rates = {
            "time/steps_per_second": added.steps / max(now - self._row_at, 1e-9),
            "rollout/env_reward": added.reward / steps,
            "rollout/intervention_rate": added.triggers / steps,
            "rollout/shield_rate": added.shield_corrections / steps,
        }
        if phase == 2:
            rates["rollout/action_similarity"] = 1.0 - added.disagreement / steps
        return rates

    def _totals(self) -> dict[str, float]:
        counts = self._recorder.counts
        whole = {name: value for name, value in asdict(counts).items() if isinstance(value, int)}
        totals: dict[str, float] = {f"count/{name}": value for name, value in whole.items()}
        totals |= {f"time/{part}": seconds for part, seconds in self.seconds.items()}
        if counts.episodes:
            totals["rollout/episode_return"], totals["rollout/success_rate"] = self._recorder.recent
        return totals


class MetricsCsv(KVWriter):
    """One row per dump, the environment step first, a new column whenever a new key turns up.

    The file is rewritten with every row, atomically. A run goes on at `step`; what it wrote after
    that, in an interval that was lost, is dropped.
    """

    def __init__(self, path: Path, step: int = 0) -> None:
        self.path = path
        earlier = read_metrics(path) if step else []
        self._rows: list[Mapping[str, Any]] = [row for row in earlier if int(row[STEP]) <= step]
        self._rewrite()

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        """Add a row."""
        kept = {key: value for key, value in key_values.items() if "csv" not in key_excluded[key]}
        self._rows.append({STEP: step} | dict(sorted(kept.items())))
        self._rewrite()

    def close(self) -> None:
        """Nothing is held open between two rows."""

    def _rewrite(self) -> None:
        columns = dict.fromkeys([STEP, *(key for row in self._rows for key in row)])
        text = StringIO(newline="")
        writer = csv.DictWriter(text, columns, restval="")
        writer.writeheader()
        writer.writerows(self._rows)
        write_text(self.path, text.getvalue())


def metrics_logger(run_dir: Path, step: int = 0) -> Logger:
    """Writes `metrics.csv` and TensorBoard events of a run that goes on at `step`."""
    run_dir.mkdir(parents=True, exist_ok=True)
    board = TensorBoardOutputFormat(str(run_dir / "tensorboard"))
    if step:
        board.writer.close()
        board.writer = SummaryWriter(str(run_dir / "tensorboard"), purge_step=step + 1)
    return Logger(str(run_dir), [MetricsCsv(run_dir / "metrics.csv", step), board])


def read_metrics(path: Path) -> list[Mapping[str, str]]:
    """All rows of a metrics file; empty strings where a row has no value, none without a file."""
    return list(csv.DictReader(path.read_text().splitlines())) if path.is_file() else []
