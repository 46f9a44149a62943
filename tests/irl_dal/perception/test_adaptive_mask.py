import numpy as np
import pytest
import torch

from irl_dal.perception import LearnableAdaptiveMask, PerceptionConfig

ROWS = 64


def bottom_row(mask: LearnableAdaptiveMask, speed: float, nearest: float) -> torch.Tensor:
    """The mask's last row at a speed [m/s] and a nearest return [m]."""
    lidar = torch.full((1, 180), 40.0)
    lidar[0, 90] = nearest
    return mask(torch.tensor([[speed]]), lidar, ROWS)[0, 0, -1, 0]


def test_levels_are_the_paper_s() -> None:
    """Speed and hazard level follow Eqs. speed_norm and hazard_level, clipped to [0, 1]."""
    mask = LearnableAdaptiveMask(PerceptionConfig(max_speed=10.0))
    speeds = torch.tensor([[-1.0], [0.0], [5.0], [20.0]])
    np.testing.assert_allclose(mask.speed_level(speeds)[:, 0], [0.0, 0.0, 0.5, 1.0])
    scans = torch.tensor([[40.0, 40.0], [9.0, 12.5], [0.0, 3.0]])
    np.testing.assert_allclose(mask.hazard_level(scans)[:, 0], [0.0, 0.25, 1.0])


def test_mask_equals_an_independent_recomputation() -> None:
    """The bounded mask is y / (H - 1) times both factors over their largest product."""
    mask = LearnableAdaptiveMask(PerceptionConfig(max_speed=10.0))
    got = mask(torch.tensor([[5.0]]), torch.full((1, 180), 9.0), ROWS)
    rows = np.arange(ROWS) / (ROWS - 1)
    expected = rows * (1 + 0.5 * 0.5) * (1 + 0.5 * 0.25) / (1.5 * 1.5)
    assert got.shape == (1, 1, ROWS, 1)
    np.testing.assert_allclose(got.detach()[0, 0, :, 0], expected, atol=1e-6)


def test_both_alphas_have_a_gradient() -> None:
    """The gradient d mask / d alpha is the analytic derivative, and not zero, for both alphas."""
    mask = LearnableAdaptiveMask(PerceptionConfig(max_speed=10.0))
    bottom_row(mask, speed=5.0, nearest=9.0).backward()
    assert mask.alpha_speed.grad is not None and mask.alpha_lidar.grad is not None
    speed_share = (1 + 0.5 * 0.5) / 1.5
    hazard_share = (1 + 0.5 * 0.25) / 1.5
    expected = hazard_share * (0.5 - 1.0) / 1.5**2
    assert float(mask.alpha_speed.grad) == pytest.approx(expected, rel=1e-4)
    expected = speed_share * (0.25 - 1.0) / 1.5**2
    assert float(mask.alpha_lidar.grad) == pytest.approx(expected, rel=1e-4)


def test_mask_shows_speed_and_hazard() -> None:
    """The bounded mask is brighter at full speed than at a standstill, and near an object."""
    mask = LearnableAdaptiveMask(PerceptionConfig())
    with torch.no_grad():
        still, fast = bottom_row(mask, 0.0, 40.0), bottom_row(mask, 12.0, 40.0)
        fast_and_near = bottom_row(mask, 12.0, 0.0)
    assert float(still) < 0.5 < 0.6 < float(fast) < 0.7
    assert float(fast_and_near) == pytest.approx(1.0, abs=1e-5)


def test_printed_normalisation_cancels_the_alphas() -> None:
    """As printed the mask is y / (H - 1) whatever the speed, and its alphas get no gradient."""
    mask = LearnableAdaptiveMask(PerceptionConfig(normalisation="printed"))
    bottom = bottom_row(mask, 12.0, 0.5)
    bottom.backward()
    assert float(bottom.detach()) == pytest.approx(1.0, abs=1e-5)
    assert mask.alpha_speed.grad is not None
    assert abs(float(mask.alpha_speed.grad)) < 1e-5


@pytest.mark.parametrize("normalisation", ["bounded", "printed"])
@pytest.mark.parametrize("alpha", [-0.9, 0.0, 0.5, 30.0])
def test_mask_stays_in_the_unit_interval(normalisation: str, alpha: float) -> None:
    """No admissible alpha takes the mask out of [0, 1], nor makes it shrink towards the bottom."""
    config = PerceptionConfig(normalisation=normalisation, initial_alpha=alpha)  # type: ignore[arg-type]
    mask = LearnableAdaptiveMask(config)
    speed = torch.linspace(-3.0, 30.0, 12)[:, None]
    lidar = torch.linspace(0.0, 60.0, 12)[:, None].expand(12, 180)
    with torch.no_grad():
        values = mask(speed, lidar, ROWS)
    assert float(values.min()) >= 0.0 and float(values.max()) <= 1.0
    assert bool((values.diff(dim=2) >= 0).all())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_speed", 0.0),
        ("max_speed", float("nan")),
        ("initial_alpha", -2.0),
    ],
)
def test_config_refuses_nonsense(name: str, value: float) -> None:
    """An impossible scale is refused by name and value."""
    with pytest.raises(ValueError, match=f"`{name}` must be .* Got {value}"):
        PerceptionConfig(**{name: value})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="`normalisation`"):
        PerceptionConfig(normalisation="own")  # type: ignore[arg-type]
