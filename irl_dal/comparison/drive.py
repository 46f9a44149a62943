"""What one process drives for a comparison."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irl_dal.cli.threads import one_thread
from irl_dal.comparison.config import ComparisonConfig, Setting
from irl_dal.config import RunConfig
from irl_dal.evaluation.metrics import episode_record, path_rows
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.rollout import compare_paths, stretches
from irl_dal.evaluation.suite import PATH_DURATION
from irl_dal.storage.result_store import ResultStore

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
    horizon = max(1, round(PATH_DURATION / job.config.limits.dt))
    with setting_rig(job, setting) as rig:
        for seed in seeds:
            record = episode_record(rig.drive(seed), job.config.limits)
            expert = store.get("expert", seed)
            assert expert is not None
            poses, rng = {seed: np.array(expert["pose"])}, np.random.default_rng(seed)
            distances = [  # from the same states in every setting
                compare_paths(rig.loop, rig.reference, rig.agent, *stretch)
                for stretch in stretches(poses, PATH_STATES, horizon, rng)
            ]
            record["rows"] |= path_rows(distances)
            store.put(f"driving/{setting.name}", seed, record)
    return len(seeds)
