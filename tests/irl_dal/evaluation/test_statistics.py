import numpy as np
import pytest
from scipy import stats

from irl_dal.evaluation.statistics import (
    Estimate,
    balanced_mean,
    difference,
    estimate,
    maximum,
    ratio,
    root_ratio,
)


def test_interval_agrees_with_scipys_percentile_bootstrap() -> None:
    """The interval of a ratio of sums is the one that scipy's own bootstrap finds."""
    rng = np.random.default_rng(0)
    counts = rng.integers(20, 60, 40).astype(float)
    events = rng.binomial(counts.astype(int), 0.2).astype(float)
    ours = estimate(np.column_stack([events, counts]), ratio, np.random.default_rng(1))
    theirs = stats.bootstrap(
        (events, counts),
        lambda a, b, axis: a.sum(axis) / b.sum(axis),
        paired=True,
        vectorized=True,
        method="percentile",
        n_resamples=20_000,
        rng=np.random.default_rng(2),
    ).confidence_interval
    assert ours.value == pytest.approx(events.sum() / counts.sum())
    width = theirs.high - theirs.low
    assert ours.low == pytest.approx(theirs.low, abs=0.1 * width)
    assert ours.high == pytest.approx(theirs.high, abs=0.1 * width)


def test_the_same_generator_gives_the_same_interval() -> None:
    """The interval depends on the rows and the generator alone."""
    rows = np.random.default_rng(3).random((15, 2))
    first, second = (estimate(rows, ratio, np.random.default_rng(7)) for _ in range(2))
    assert first == second


@pytest.mark.parametrize("rows", [np.empty((0, 2)), np.zeros((3, 2))])
def test_nothing_measured_is_none(rows: np.ndarray) -> None:
    """No rows, or a denominator that sums to zero, give no number instead of NaN."""
    assert estimate(rows, ratio, np.random.default_rng(0)) == Estimate(None, None, None)


def test_balanced_mean_gives_each_present_class_the_same_weight() -> None:
    """A class with one state weighs as much as one with a hundred; an empty one not at all."""
    sums, counts = [100.0, 3.0, 0.0], [100.0, 1.0, 0.0]
    rows = np.array([[[*sums, *counts]]])
    assert balanced_mean(rows)[0] == pytest.approx((1.0 + 3.0) / 2.0)


def test_other_statistics() -> None:
    """Root of a mean square, and the largest value."""
    assert root_ratio(np.array([[[9.0, 1.0], [7.0, 3.0]]]))[0] == pytest.approx(2.0)
    assert maximum(np.array([[[1.0], [5.0], [2.0]]]))[0] == 5.0


def test_wrong_shapes_are_refused() -> None:
    """Rows that are no table say so."""
    with pytest.raises(ValueError, match="`rows`"):
        estimate(np.zeros(3), ratio, np.random.default_rng(0))


def test_a_paired_difference_is_resampled_in_pairs() -> None:
    """Episodes that all differ by the same amount leave no uncertainty about the difference."""
    rng = np.random.default_rng(0)
    second = np.column_stack([rng.normal(0.0, 10.0, 30), np.ones(30)])
    first = second + [2.0, 0.0]
    paired = estimate(np.hstack([first, second]), difference(ratio), np.random.default_rng(1))
    assert paired.value == pytest.approx(2.0)
    assert (paired.low, paired.high) == (pytest.approx(2.0), pytest.approx(2.0))
    shuffled = np.hstack([first, second[::-1]])
    apart = estimate(shuffled, difference(ratio), np.random.default_rng(1))
    assert apart.low is not None and apart.low < 0.0
