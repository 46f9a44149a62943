"""Uncertainty of every reported number: percentile bootstrap over episodes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

Statistic = Callable[[Array], Array]
"""Maps resampled rows (B, N, K) to one number per resample (B,)."""

RESAMPLES = 2000  # of the bootstrap: an interval's ends repeat to about 1.5 % of its width
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number and its 95 % bootstrap interval; None where there was nothing to measure."""

    value: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def bounds(self) -> list[float] | None:
        """Both ends of the interval."""
        return None if self.low is None or self.high is None else [self.low, self.high]

    def entries(self, name: str) -> dict[str, float | list[float] | None]:
        """`name` and `<name>_ci95` of a flat report."""
        return {name: self.value, f"{name}_ci95": self.bounds}


def ratio(rows: Array) -> Array:
    """Sum of column 0 over sum of column 1, (B, N, 2) -> (B,); NaN where the latter is zero."""
    sums = rows.sum(axis=1)
    return divide(sums[:, 0], sums[:, 1])


def root_ratio(rows: Array) -> Array:
    """Root of the mean square: square root of `ratio`, (B, N, 2) -> (B,)."""
    return np.sqrt(ratio(rows))


def maximum(rows: Array) -> Array:
    """Largest value of column 0, (B, N, 1) -> (B,)."""
    return np.asarray(rows[:, :, 0].max(axis=1))


def balanced_mean(rows: Array) -> Array:
    """Mean over classes of the mean within each class, (B, N, 2 C) -> (B,).

    The first C columns are sums per class, the last C are counts. A class without a single member
    in a resample does not enter that resample's mean.
    """
    sums, counts = np.split(rows.sum(axis=1), 2, axis=1)
    means = divide(sums, counts)
    present = counts > 0.0
    return divide(np.where(present, means, 0.0).sum(axis=1), present.sum(axis=1))


def difference(statistic: Statistic) -> Statistic:
    """How much larger a statistic is on the first half of the columns than on the second.

    Rows then pair two measurements of one episode (N, 2 K): both are resampled together.
    """

    def subtract(rows: Array) -> Array:
        first, second = np.split(rows, 2, axis=2)
        return statistic(first) - statistic(second)

    return subtract


def estimate(rows: ArrayLike, statistic: Statistic, rng: np.random.Generator) -> Estimate:
    """Value of a statistic of rows (N, K), one per episode, with its percentile bootstrap interval.

    All None where there are no rows or the value is not finite.
    """
    table = np.asarray(rows, dtype=np.float64)
    if table.ndim != 2:
        raise ValueError(f"`rows` must have shape (N, K). Got {table.shape}.")
    value = float(statistic(table[None])[0]) if len(table) else np.nan
    if not np.isfinite(value):
        return Estimate()
    samples = statistic(table[rng.integers(len(table), size=(RESAMPLES, len(table)))])
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.nanpercentile(samples, [tail, 100.0 - tail])
    return Estimate(value, float(low), float(high))


def divide(numerator: Array, denominator: Array) -> Array:
    """Quotient with NaN, and no warning, where the denominator is zero."""
    quotient: Array = np.full(np.broadcast_shapes(numerator.shape, denominator.shape), np.nan)
    np.divide(numerator, denominator, out=quotient, where=denominator != 0)
    return quotient
