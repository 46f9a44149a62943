"""What one process drives for a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from irl_dal.cli.threads import one_thread
from irl_dal.comparison.config import ComparisonConfig
from irl_dal.comparison.settings import Setting
from irl_dal.config import RunConfig
from irl_dal.evaluation.metrics import episode_record, path_rows
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.rollout import compare_paths, spread_steps
from irl_dal.storage.result_store import ResultStore

Array = NDArray[np.float64]

PATH_DURATION = 5.0  # [s] of the paths behind ADE and FDE, as in an evaluation
PATH_STATES = 1  # states per episode from which these paths start


@dataclass(frozen=True, slots=True)
class ComparisonJob:
    """What is compared; small enough to be sent to another process."""

    config: RunConfig  # of the run
    run_dir: Path
    comparison: ComparisonConfig
    out: Path  # folder of the results

    @property
    def results(self) -> Path:
        """The numbers."""
        return self.out / "compare.json"

    @property
    def page(self) -> Path:
        """The page."""
        return self.out / "index.html"

    @property
    def film(self) -> Path:
        """The side-by-side video; the page embeds it."""
        return self.out / "film.webm"


@contextmanager
def setting_rig(
    job: ComparisonJob, setting: Setting, render_mode: str | None = None
) -> Iterator[Rig]:
    """The run's policy in a setting, on one thread."""
    spec = AgentSpec("run", job.run_dir)
    with one_thread(), closing(Rig.build(setting.configure(job.config), spec, render_mode)) as rig:
        yield rig


def drive_setting(
    job: ComparisonJob, store: ResultStore, setting: Setting, seeds: Sequence[int]
) -> int:
    """Drive a setting's episodes, keep each as soon as it is over, and say how many there were."""
    with setting_rig(job, setting) as rig:
        for seed in seeds:
            record = episode_record(rig.drive(seed), job.config.limits)
            distances = [
                compare_paths(rig.loop, rig.reference, rig.agent, seed, step, pose)
                for step, pose in _stretches(job, store, seed)
            ]
            record["rows"] |= path_rows(distances)
            store.put(f"driving/{setting.name}", seed, record)
    return len(seeds)


def _stretches(job: ComparisonJob, store: ResultStore, seed: int) -> Iterator[tuple[int, Array]]:
    """Where a path is compared with the expert's, the same in every setting."""
    expert = store.get("expert", seed)
    assert expert is not None
    pose = np.array(expert["pose"])
    horizon = max(1, round(PATH_DURATION / job.config.limits.dt))
    rng = np.random.default_rng(seed)
    (steps,) = spread_steps([len(pose) - 1], PATH_STATES, horizon, rng)
    for step in steps:
        yield step, pose[step : step + 1 + horizon]
