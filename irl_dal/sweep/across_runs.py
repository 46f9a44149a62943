"""From runs to numbers of a variant: interquartile mean and stratified bootstrap over the runs.

Agarwal et al., Deep reinforcement learning at the edge of the statistical precipice, 2021
(doi:10.48550/arXiv.2108.13264), with their library `rliable`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from rliable.library import get_interval_estimates
from rliable.metrics import aggregate_iqm

from irl_dal.evaluation.statistics import CONFIDENCE, Array, Estimate
from irl_dal.sweep.result import RunResult

RESAMPLES, BAND_RESAMPLES = 2000, 400


class Band(NamedTuple):
    """Interquartile mean and its interval's ends over the environment steps of a training (S,)."""

    steps: Array
    middle: Array
    low: Array
    high: Array


def across_runs(results: Sequence[RunResult], metric: str, rng: np.random.Generator) -> Estimate:
    """Interquartile mean of a metric over runs, with its 95 % interval from two runs on."""
    known = [value for result in results if (value := result.score(metric)) is not None]
    if not known:
        return Estimate()
    ends = _interquartile(np.array(known, np.float64)[:, None], RESAMPLES, rng)
    return Estimate(*(float(end[0]) for end in ends[: 1 if len(known) == 1 else 3]))


def band(results: Sequence[RunResult], column: str, rng: np.random.Generator) -> Band | None:
    """A column of the metrics over the steps at which every run has a value; None without any."""
    tables = [dict(zip(run.steps, run.curves[column], strict=True)) for run in results]
    tables = [{k: v for k, v in table.items() if v is not None} for table in tables]
    steps = sorted(set.intersection(*map(set, tables))) if tables else []
    if not steps:
        return None
    values = np.array([[table[step] for step in steps] for table in tables], np.float64)
    return Band(np.array(steps, np.float64), *_interquartile(values, BAND_RESAMPLES, rng))


def _interquartile(
    scores: Array, resamples: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Interquartile means of the columns of (runs, S), and their intervals' ends: three (S,)."""

    def means(table: Array) -> Array:
        return np.array([aggregate_iqm(column[:, None]) for column in table.T])

    if len(scores) == 1:
        return scores[0], scores[0], scores[0]
    with _seeded(rng):
        middles, intervals = get_interval_estimates(
            {"runs": scores}, means, reps=resamples, confidence_interval_size=CONFIDENCE
        )
    low, high = intervals["runs"]
    return middles["runs"], low, high


@contextmanager
def _seeded(rng: np.random.Generator) -> Iterator[None]:
    """Lend numpy's global generator, which `rliable` draws from, a seed of ours."""
    state = np.random.get_state()
    np.random.seed(int(rng.integers(2**32)))
    try:
        yield
    finally:
        np.random.set_state(state)
