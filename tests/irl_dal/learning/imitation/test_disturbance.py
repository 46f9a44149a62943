"""Bursts have the stated rate, size and length."""

import numpy as np
import pytest

from irl_dal.learning.imitation.disturbance import Disturbance, DisturbanceConfig


def test_bursts_are_as_configured() -> None:
    """Offsets stay in their box, bursts have the stated lengths, calm steps prevail."""
    config = DisturbanceConfig()
    disturbance = Disturbance(config, np.random.default_rng(0))
    offsets = [disturbance.step() for _ in range(20_000)]
    active = np.array([o is not None for o in offsets])
    values = np.array([o for o in offsets if o is not None])
    assert np.abs(values[:, 0]).max() <= config.steering
    assert -config.slower <= values[:, 1].min() and values[:, 1].max() <= config.faster
    starts = np.flatnonzero(np.diff(active.astype(int)) == 1)
    stops = np.flatnonzero(np.diff(active.astype(int)) == -1)
    lengths = stops[stops > starts[0]][:100] - starts[:100]
    assert lengths.min() >= config.shortest
    mean = 0.5 * (config.shortest + config.longest)
    expected = config.rate * mean / (1.0 + config.rate * mean)
    assert active.mean() == pytest.approx(expected, rel=0.2)


def test_zero_rate_never_disturbs() -> None:
    """The paper's undisturbed expert."""
    disturbance = Disturbance(DisturbanceConfig(rate=0.0), np.random.default_rng(0))
    assert all(disturbance.step() is None for _ in range(1000))


@pytest.mark.parametrize(
    ("field", "value"), [("rate", 1.5), ("steering", -0.1), ("shortest", 0), ("longest", 2)]
)
def test_nonsense_is_refused(field: str, value: float) -> None:
    """The error shows the value."""
    with pytest.raises(ValueError, match=str(value)):
        DisturbanceConfig(**{field: value})
