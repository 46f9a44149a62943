"""How fast a plan turns into noise.

| variable      | paper / Ho et al. (2020) |
|---------------|--------------------------|
| `steps`       | T                        |
| `alpha_bar[k]`| alpha-bar_k, k = 0 ... T, with alpha-bar_0 = 1 |
| `beta[k]`     | beta_k, k = 1 ... T      |

References:
    Ho et al., Denoising Diffusion Probabilistic Models, 2020.
    Nichol and Dhariwal, Improved Denoising Diffusion Probabilistic Models, 2021 (cosine).
"""

from dataclasses import dataclass
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from irl_dal.arrays import Array

ScheduleKind = Literal["cosine", "printed"]

FIRST_BETA, LAST_BETA = 1e-4, 0.02  # The paper's linear schedule
COSINE_OFFSET = 0.008  # Keeps beta_1 from vanishing (Nichol and Dhariwal)
LARGEST_BETA = 0.999  # Keeps alpha-bar_T above zero (Nichol and Dhariwal)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseSchedule:
    """Variances of the forward process, read-only."""

    alpha_bar: Array  # Share of the signal's variance left after k steps, (T + 1,)

    @classmethod
    def make(cls, kind: ScheduleKind = "cosine", steps: int = 100) -> Self:
        """A schedule of T = `steps`; `ValueError` for an unknown kind, or fewer than two steps.

        `printed` are the paper's betas, which leave 36 % of the signal's variance after 100 steps.
        """
        if kind not in get_args(ScheduleKind):
            raise ValueError(f"`schedule` must be one of {get_args(ScheduleKind)}. Got {kind!r}.")
        if steps < 2:
            raise ValueError(f"`diffusion_steps` must be at least 2. Got {steps}.")
        linear = np.linspace(FIRST_BETA, LAST_BETA, steps)
        beta = _cosine(steps) if kind == "cosine" else linear
        alpha_bar = np.concatenate([[1.0], np.cumprod(1.0 - beta)])
        alpha_bar.setflags(write=False)
        return cls(alpha_bar)

    @property
    def steps(self) -> int:
        """T, the number of diffusion steps."""
        return len(self.alpha_bar) - 1

    @property
    def beta(self) -> Array:
        """Variances beta_k of one forward step, (T + 1,), with beta_0 = 0."""
        return np.concatenate([[0.0], 1.0 - self.alpha_bar[1:] / self.alpha_bar[:-1]])

    def signal(self, k: NDArray[np.int64]) -> Array:
        """The factor sqrt(alpha-bar_k) of the clean plan."""
        return np.sqrt(self.alpha_bar[k])

    def noise(self, k: NDArray[np.int64]) -> Array:
        """The factor sqrt(1 - alpha-bar_k) of the noise."""
        return np.sqrt(1.0 - self.alpha_bar[k])


def _cosine(steps: int) -> Array:
    """Betas beta_1 ... beta_T of a squared-cosine alpha-bar, capped."""
    time = np.arange(steps + 1) / steps
    target = np.cos((time + COSINE_OFFSET) / (1.0 + COSINE_OFFSET) * np.pi / 2.0) ** 2
    return np.minimum(1.0 - target[1:] / target[:-1], LARGEST_BETA)
