import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from irl_dal.planner.noise_schedule import NoiseSchedule
from irl_dal.planner.sampler import (
    Refinement,
    Sampler,
    Transitions,
    ddim_transitions,
    ddpm_transitions,
)

Array = NDArray[np.float64]

MEAN, STD = 0.3, 0.5
"""Toy data: every entry of a chunk is Gaussian, so that the best denoiser is known."""


class GaussianDenoiser:
    """The conditional mean of Gaussian data given x_k, or of the noise."""

    def __init__(self, transitions: Transitions, prediction: str = "x0") -> None:
        self.table = transitions
        self.prediction = prediction

    def gain(self, index: int) -> float:
        """Slope of the conditional mean in x_k."""
        signal, noise = self.table.signal[index], self.table.noise[index]
        return float(signal * STD**2 / ((signal * STD) ** 2 + noise**2))

    def __call__(self, noisy: Array, index: int) -> Array:
        """Predict (B, H, 2)."""
        signal, noise = self.table.signal[index], self.table.noise[index]
        clean = MEAN + self.gain(index) * (noisy - signal * MEAN)
        return clean if self.prediction == "x0" else (noisy - signal * clean) / noise


def generator(seed: int = 0) -> torch.Generator:
    """A seeded source of randomness."""
    return torch.Generator().manual_seed(seed)


def tables() -> dict[str, Transitions]:
    """Samplers worth testing."""
    schedule = NoiseSchedule.make("cosine", 100)
    return {
        "ddpm": ddpm_transitions(schedule),
        "ddim": ddim_transitions(schedule, 50),
    }


@pytest.mark.parametrize("prediction", ["x0", "epsilon"])
@pytest.mark.parametrize("name", ["ddpm", "ddim"])
def test_samples_have_the_data_s_mean_and_variance(name: str, prediction: str) -> None:
    """With the exact denoiser, unguided samples have the mean and spread of the data."""
    table = tables()[name]
    sampler = Sampler(table, prediction)  # type: ignore[arg-type]
    samples = sampler.sample(
        GaussianDenoiser(table, prediction), sampler.draw(generator(), 1000, 8)
    )
    assert samples is not None
    assert samples.mean() == pytest.approx(MEAN, abs=0.01)
    assert samples.std() == pytest.approx(STD, rel=0.04)


def test_printed_schedule_misses_the_data() -> None:
    """Sampling the printed schedule from N(0, I) starts off the distribution and lands off it."""
    table = ddpm_transitions(NoiseSchedule.make("printed", 100))
    sampler = Sampler(table)
    samples = sampler.sample(GaussianDenoiser(table), sampler.draw(generator(), 1000, 8))
    assert samples is not None
    assert abs(samples.mean() - MEAN) > 0.03


@pytest.mark.parametrize("name", ["ddpm", "ddim"])
def test_spread_follows_the_exact_recursion(name: str) -> None:
    """The sampler's variance equals that of the linear recursion it must be on Gaussian data."""
    table = tables()[name]
    denoiser, variance = GaussianDenoiser(table), 1.0
    for index in range(len(table) - 1):
        slope = table.clean_factor[index] * denoiser.gain(index) + table.noisy_factor[index]
        variance = slope**2 * variance + table.sigma[index] ** 2
    variance *= denoiser.gain(len(table) - 1) ** 2
    sampler = Sampler(table)
    samples = sampler.sample(denoiser, sampler.draw(generator(1), 4000, 8))
    assert samples is not None
    assert samples.var() == pytest.approx(variance, rel=0.02)


def test_posterior_against_bayes() -> None:
    """Each DDPM step is the Gaussian posterior of x_{k-1} given x_k and x_0, by Bayes' rule."""
    schedule = NoiseSchedule.make("cosine", 20)
    table = ddpm_transitions(schedule)
    for index, k in enumerate(table.k[:-1]):
        prior_precision = 1.0 / (1.0 - schedule.alpha_bar[k - 1])
        forward = 1.0 - schedule.beta[k]
        precision = prior_precision + forward / schedule.beta[k]
        clean = np.sqrt(schedule.alpha_bar[k - 1]) * prior_precision / precision
        noisy = np.sqrt(forward) / schedule.beta[k] / precision
        assert table.clean_factor[index] == pytest.approx(clean, rel=1e-9)
        assert table.noisy_factor[index] == pytest.approx(noisy, rel=1e-9)
        assert table.sigma[index] ** 2 == pytest.approx(1.0 / precision, rel=1e-9)


def test_last_step_returns_the_clean_estimate() -> None:
    """Both samplers end at x_0 with no noise left."""
    for table in tables().values():
        assert table.sigma[-1] == 0.0
        assert table.noisy_factor[-1] == pytest.approx(0.0, abs=1e-12)
        assert table.clean_factor[-1] == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["ddpm", "ddim"])
def test_same_seed_same_sample(name: str) -> None:
    """The generator handed in decides everything."""
    sampler = Sampler(tables()[name])
    denoiser = GaussianDenoiser(tables()[name])
    first, again, other = (
        sampler.sample(denoiser, sampler.draw(generator(seed), 2, 8)) for seed in (3, 3, 4)
    )
    assert first is not None and again is not None and other is not None
    np.testing.assert_array_equal(first, again)
    assert float(np.abs(first - other).max()) > 1e-3


def test_refinements_and_deadline() -> None:
    """Refinements see every step but the last, in order; a deadline gives up."""

    class Spy(Refinement):
        seen: list[tuple[str, int]] = []

        def clean(self, clean: Array, index: int) -> Array:
            self.seen.append(("clean", index))
            return clean + 1.0

        def noisy(self, noisy: Array, index: int) -> Array:
            self.seen.append(("noisy", index))
            return noisy

    table = ddim_transitions(NoiseSchedule.make("cosine", 100), 3)
    sampler = Sampler(table, clip=0.25)
    draws = sampler.draw(generator(), 1, 8)
    result = sampler.sample(GaussianDenoiser(table), draws, [Spy()])
    assert Spy.seen == [("clean", 0), ("noisy", 0), ("clean", 1), ("noisy", 1)]
    assert result is not None
    assert -0.25 <= float(result.min()) <= float(result.max()) <= 0.25
    answers = iter([False, True])
    assert sampler.sample(GaussianDenoiser(table), draws, (), lambda: next(answers)) is None


def test_nonsense_is_refused() -> None:
    """More reverse steps than diffusion steps are refused."""
    schedule = NoiseSchedule.make("cosine", 10)
    with pytest.raises(ValueError, match="`sampling_steps` must be in 1 ... 10. Got 11"):
        ddim_transitions(schedule, 11)


@pytest.mark.parametrize("prediction", ["sample", "epsilon"])
@pytest.mark.parametrize("name", ["ddpm", "ddim"])
def test_agrees_with_diffusers_step_by_step(name: str, prediction: str) -> None:
    """Every reverse step equals that of the schedulers of `diffusers`."""
    diffusers = pytest.importorskip("diffusers", reason="pip install 'diffusers>=0.30'")
    schedule = NoiseSchedule.make("cosine", 100)
    settings = {
        "num_train_timesteps": 100,
        "trained_betas": schedule.beta[1:],
        "prediction_type": prediction,
        "clip_sample": False,
    }
    if name == "ddpm":
        table = ddpm_transitions(schedule)
        reference = diffusers.DDPMScheduler(variance_type="fixed_small", **settings)
    else:
        table = ddim_transitions(schedule, 10)
        reference = diffusers.DDIMScheduler(timestep_spacing="trailing", **settings)
    reference.set_timesteps(len(table))
    np.testing.assert_array_equal(reference.timesteps + 1, table.k)
    kind = "x0" if prediction == "sample" else "epsilon"
    denoiser = GaussianDenoiser(table, kind)
    sampler = Sampler(table, kind)  # type: ignore[arg-type]
    shape = (2, 8, 2)
    noise = [torch.randn(shape, generator=generator(i), dtype=torch.float64) for i in range(100)]
    draws = torch.stack(noise).numpy()
    theirs, path = torch.from_numpy(draws[0]), []

    class Path(Refinement):
        def noisy(self, noisy: Array, index: int) -> Array:
            path.append(noisy.copy())
            return noisy

    ours = sampler.sample(denoiser, draws, [Path()])
    assert ours is not None
    for index, timestep in enumerate(reference.timesteps):
        output = torch.from_numpy(denoiser(theirs.numpy(), index))
        extra = {"generator": generator(index + 1)} if name == "ddpm" else {"eta": 0.0}
        theirs = reference.step(output, timestep, theirs, **extra).prev_sample
        expected = [*path, ours][index]
        np.testing.assert_allclose(expected, theirs.numpy(), atol=2e-5)  # its tables are float32
