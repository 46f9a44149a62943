import numpy as np
import pytest
import torch

from irl_dal.planner.denoiser import ConditionalUnet1d, embed_step
from irl_dal.planner.fast_denoiser import FastDenoiser


def network(width: int = 64, seed: int = 0) -> ConditionalUnet1d:
    """A network with weights large enough that a mistake shows."""
    torch.manual_seed(seed)
    unet = ConditionalUnet1d(width)
    with torch.no_grad():
        for parameter in unet.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return unet


def test_size() -> None:
    """The default network has 0.2 to 0.45 million parameters."""
    count = sum(parameter.numel() for parameter in ConditionalUnet1d().parameters())
    assert 200_000 < count < 450_000


@pytest.mark.parametrize("horizon", [2, 8, 16])
def test_every_input_matters(horizon: int) -> None:
    """The prediction has the chunk's shape and depends on chunk, k and context."""
    unet = network(16)
    noisy, k = torch.randn(3, horizon, 2), torch.tensor([1, 50, 100])
    context = torch.randn(3, 64)
    with torch.no_grad():
        plain = unet(noisy, k, context)
        assert plain.shape == (3, horizon, 2)
        others = unet(-noisy, k, context), unet(noisy, k - 1, context), unet(noisy, k, -context)
    for other in others:
        assert float((other - plain).abs().max()) > 1e-3


def test_odd_horizon_is_refused() -> None:
    """A chunk that cannot be halved is refused."""
    with pytest.raises(ValueError, match="`horizon` must be even.* Got 7"):
        network(16)(torch.zeros(1, 7, 2), torch.ones(1), torch.zeros(1, 64))


@pytest.mark.parametrize("shape", [(1, 63), (64,), (1, 1, 64)])
def test_a_context_of_another_size_is_refused(shape: tuple[int, ...]) -> None:
    """Both networks name the size that they take and the size of the argument."""
    unet = network(16)
    with pytest.raises(ValueError, match=r"`context` must have shape \(B, 64\). Got \("):
        unet(torch.zeros(1, 8, 2), torch.ones(1), torch.zeros(shape))
    with pytest.raises(ValueError, match=r"`context` must have shape \(B, 64\). Got \("):
        FastDenoiser(unet, np.array([1])).condition(np.zeros(shape, np.float32))


def test_step_embedding_tells_the_steps_apart() -> None:
    """The embeddings of all k of T = 100 differ clearly."""
    codes = embed_step(torch.arange(101))
    gaps = torch.cdist(codes, codes) + 10.0 * torch.eye(101)
    assert float(gaps.min()) > 0.5


@pytest.mark.parametrize("width", [16, 64])
@pytest.mark.parametrize(("batch", "horizon"), [(1, 8), (5, 8), (2, 16)])
def test_fast_denoiser_is_the_network(batch: int, horizon: int, width: int) -> None:
    """The compiled network predicts what the torch network does, for every reverse step."""
    unet = network(width)
    steps = np.array([100, 61, 7, 1])
    fast = FastDenoiser(unet, steps)
    rng = np.random.default_rng(0)
    context = rng.normal(size=(1, 64)).astype(np.float32)
    films = fast.condition(context)
    for index, k in enumerate(steps):
        noisy = rng.normal(size=(batch, horizon, 2))
        with torch.no_grad():
            expected = unet(
                torch.from_numpy(noisy).float(),
                torch.full((batch,), int(k)),
                torch.from_numpy(context).expand(batch, -1),
            )
        got = fast.predict(noisy, films, index)
        np.testing.assert_allclose(got, expected, atol=2e-5, rtol=2e-5)


def test_fast_denoiser_bears_large_inputs() -> None:
    """Inputs far outside training stay numbers and agree with the torch network."""
    unet = network(16)
    fast = FastDenoiser(unet, np.array([50]))
    noisy = np.full((1, 8, 2), 1e6)
    context = np.full((1, 64), -1e4, np.float32)
    got = fast.predict(noisy, fast.condition(context), 0)
    with torch.no_grad():
        expected = unet(
            torch.from_numpy(noisy).float(), torch.tensor([50]), torch.from_numpy(context)
        )
    assert bool(np.isfinite(got).all())
    np.testing.assert_allclose(got, expected, rtol=1e-3)


def test_repeated_calls_do_not_disturb_each_other() -> None:
    """Nothing is carried from one call to the next, nor between batch sizes."""
    fast = FastDenoiser(network(16), np.array([50]))
    rng = np.random.default_rng(1)
    films = fast.condition(rng.normal(size=(1, 64)).astype(np.float32))
    one, many = rng.normal(size=(1, 8, 2)), rng.normal(size=(4, 8, 2))
    first = fast.predict(one, films, 0).copy()
    fast.predict(many, films, 0)
    fast.predict(-one, films, 0)
    np.testing.assert_array_equal(fast.predict(one, films, 0), first)


@pytest.mark.parametrize("written", ["in place", "by assignment", "loaded"])
def test_a_snapshot_knows_when_a_weight_has_changed(written: str) -> None:
    """However a weight is changed, the snapshot is no longer current; equal weights keep it so."""
    unet = network(16)
    fast = FastDenoiser(unet, np.array([50]))
    unet.load_state_dict(network(16).state_dict())
    assert fast.is_current()
    with torch.no_grad():
        if written == "in place":
            unet.out.bias.numpy()[0] += 1.0  # torch's own count of changes does not see this
        elif written == "by assignment":
            unet.out.bias = torch.nn.Parameter(unet.out.bias + 1.0)
        else:
            unet.load_state_dict(network(16, seed=1).state_dict())
    assert not fast.is_current()
