"""Bursts have the documented rate, size and length."""

import numpy as np
import pytest

from irl_dal.learning.imitation.disturbance import DURATION, HIGHEST, LOWEST, Disturbance

RATE = 0.025


def test_bursts_are_as_documented() -> None:
    """Offsets stay in their box, bursts have the documented lengths, calm steps prevail."""
    disturbance = Disturbance(np.random.default_rng(0), RATE)
    offsets = [disturbance.step() for _ in range(20_000)]
    active = np.array([o is not None for o in offsets])
    values = np.array([o for o in offsets if o is not None])
    assert np.all(values >= LOWEST) and np.all(values <= HIGHEST)
    assert values.min(axis=0) == pytest.approx(LOWEST, rel=0.05)
    starts = np.flatnonzero(np.diff(active.astype(int)) == 1)
    stops = np.flatnonzero(np.diff(active.astype(int)) == -1)
    lengths = stops[stops > starts[0]][:100] - starts[:100]
    assert lengths.min() >= DURATION[0]
    mean = 0.5 * sum(DURATION)
    assert active.mean() == pytest.approx(RATE * mean / (1.0 + RATE * mean), rel=0.2)


def test_zero_rate_never_disturbs() -> None:
    """The paper's undisturbed expert."""
    disturbance = Disturbance(np.random.default_rng(0), 0.0)
    assert all(disturbance.step() is None for _ in range(1000))
