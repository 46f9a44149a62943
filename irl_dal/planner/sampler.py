"""From noise to a plan: one loop for DDPM and DDIM.

Every reverse step has the form x_{k'} = a * clean + b * x_k + sigma * z, so a sampler is a table of
(k, a, b, sigma) and the loop does not know which sampler it runs.

| variable | paper / Ho et al. (2020), Song et al. (2021)                |
|----------|-------------------------------------------------------------|
| `noisy`  | x_k, in normalised actions                                  |
| `clean`  | A-hat^0_k, the estimate of x_0; A-tilde^0_k once refined     |
| `a`, `b` | Eq. (7) of Ho et al.; Eq. (12) of Song et al.               |
| `sigma`  | square root of the posterior variance (DDPM); 0 (DDIM)       |
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from irl_dal.arrays import Array
from irl_dal.planner.noise_schedule import NoiseSchedule

Prediction = Literal["x0", "epsilon"]

# (noisy (B, H, 2), index into the table) to the network's output (B, H, 2)
Predict = Callable[[Array, int], NDArray[np.floating[Any]]]


@dataclass(frozen=True, slots=True, eq=False)
class Transitions:
    """Coefficients of the reverse steps, first to last, read-only arrays of length S."""

    k: NDArray[np.int64]  # Diffusion step that each reverse step starts from, T first
    clean_factor: Array  # a
    noisy_factor: Array  # b
    sigma: Array  # Standard deviation of the fresh noise; 0 at the last step
    signal: Array  # sqrt(alpha-bar_k)
    noise: Array  # sqrt(1 - alpha-bar_k)

    def __post_init__(self) -> None:
        for name in self.__slots__:
            getattr(self, name).setflags(write=False)

    def __len__(self) -> int:
        return len(self.k)


def ddpm_transitions(schedule: NoiseSchedule) -> Transitions:
    """All T ancestral steps with the posterior's mean and variance (Ho et al., Eqs. 6 and 7)."""
    k = np.arange(schedule.steps, 0, -1)
    kept, before, beta = schedule.alpha_bar[k], schedule.alpha_bar[k - 1], schedule.beta[k]
    return Transitions(
        k=k,
        clean_factor=np.sqrt(before) * beta / (1.0 - kept),
        noisy_factor=np.sqrt(1.0 - beta) * (1.0 - before) / (1.0 - kept),
        sigma=np.sqrt(beta * (1.0 - before) / (1.0 - kept)),
        signal=schedule.signal(k),
        noise=schedule.noise(k),
    )


def ddim_transitions(schedule: NoiseSchedule, steps: int) -> Transitions:
    """S evenly spaced deterministic steps from T to 0 (Song et al., Eq. 12 with sigma = 0).

    The spacing starts at T itself, because only there the iterate is noise alone. `ValueError` for
    `steps` outside 1 ... T.
    """
    if not 1 <= steps <= schedule.steps:
        raise ValueError(f"`sampling_steps` must be in 1 ... {schedule.steps}. Got {steps}.")
    grid = np.round(np.linspace(schedule.steps, 0, steps + 1)).astype(np.int64)
    k, target = grid[:-1], grid[1:]
    kept, before = schedule.alpha_bar[k], schedule.alpha_bar[target]
    noisy_factor = np.sqrt((1.0 - before) / (1.0 - kept))
    return Transitions(
        k=k,
        clean_factor=np.sqrt(before) - noisy_factor * np.sqrt(kept),
        noisy_factor=noisy_factor,
        sigma=np.zeros(steps),
        signal=schedule.signal(k),
        noise=schedule.noise(k),
    )


class Refinement:
    """What may change the sample in all reverse steps but the last. The base changes nothing."""

    def clean(self, clean: Array, index: int) -> Array:
        """A better clean estimate (B, H, 2) at reverse step `index`; never written in place."""
        return clean

    def noisy(self, noisy: Array, index: int) -> Array:
        """A better iterate (B, H, 2) for the end of reverse step `index`."""
        return noisy


class Sampler:
    """The reverse process; clean estimates are clipped to [-clip, clip], None for never."""

    def __init__(
        self, transitions: Transitions, prediction: Prediction = "x0", clip: float | None = None
    ) -> None:
        self.transitions = transitions
        self.prediction = prediction
        self.clip = clip

    def draw(self, generator: torch.Generator, batch: int, horizon: int) -> Array:
        """All random numbers of one `sample`: (1 where no step adds noise, else S, B, H, 2)."""
        count = len(self.transitions) if self.transitions.sigma.any() else 1
        shape = (count, batch, horizon, 2)
        drawn = torch.randn(shape, generator=generator, device=generator.device)
        return drawn.double().cpu().numpy()

    def sample(
        self,
        predict: Predict,
        draws: Array,
        refinements: Sequence[Refinement] = (),
        expired: Callable[[], bool] | None = None,
    ) -> Array | None:
        """The last clean estimate (B, H, 2); None once `expired`, asked before each step, says so.

        `draws` are `draw`'s: the first slice is x_T. The refinements are applied in order to the
        clean estimate and the iterate of each step but the last, which is the caller's to refine.
        """
        table = self.transitions
        noisy = draws[0].copy()
        for index in range(len(table)):
            if expired is not None and expired():
                return None
            clean = self._clean(predict(noisy, index), noisy, index)
            if index + 1 == len(table):
                break
            for refinement in refinements:
                clean = refinement.clean(clean, index)
            noisy *= table.noisy_factor[index]
            noisy += table.clean_factor[index] * clean
            if table.sigma[index] > 0.0:
                noisy += table.sigma[index] * draws[index + 1]
            for refinement in refinements:
                noisy = refinement.noisy(noisy, index)
        return clean

    def _clean(self, output: NDArray[np.floating[Any]], noisy: Array, index: int) -> Array:
        """The network's output as a clean estimate, clipped."""
        clean = np.asarray(output, dtype=np.float64)
        if self.prediction == "epsilon":
            table = self.transitions
            clean = (noisy - table.noise[index] * clean) / table.signal[index]
        if self.clip is not None:
            clean = np.clip(clean, -self.clip, self.clip)
        return clean
