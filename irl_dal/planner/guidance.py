"""Energy guidance of the clean estimate, Eq. dal_guidance.

| variable   | paper          |
|------------|----------------|
| `clean`    | A-hat^0_k      |
| `scale`    | w_g            |
| result     | A-tilde^0_k    |
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irl_dal.planner.energy import TotalEnergy
from irl_dal.planner.sampler import Refinement

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GuidanceConfig:
    """How strongly the energies push.

    Attributes:
        scale: w_g (Table II): length of a step, in normalised actions over the whole chunk; 0
            switches guidance off.
        epsilon: Added to the gradient's norm. Below it the step shrinks with the gradient instead
            of keeping its length, so that a plan at the energy's minimum is left where it is. The
            paper means a number that only avoids a division by zero.

    Raises:
        ValueError: A value that cannot be meant.
    """

    scale: float = 0.1
    epsilon: float = 1e-6

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale >= 0):
            raise ValueError(f"`scale` must be finite and not negative. Got {self.scale}.")
        if not (math.isfinite(self.epsilon) and self.epsilon > 0):
            raise ValueError(f"`epsilon` must be finite and positive. Got {self.epsilon}.")


class Guidance(Refinement):
    """One normalised gradient step per reverse step.

    Args:
        energy: Composite energy of this context.
        config: Step length.

    Attributes:
        energy_before: Energies (B,) of the last estimate before its step; None at first.
    """

    def __init__(self, energy: TotalEnergy, config: GuidanceConfig) -> None:
        self._energy = energy
        self._config = config
        self.energy_before: Array | None = None

    def clean(self, clean: Array, index: int) -> Array:
        """The estimate (B, H, 2) moved towards lower energy."""
        self.energy_before, gradient = self._energy.evaluate(clean)
        norm: Array = np.sqrt(np.einsum("bhc,bhc->b", gradient, gradient))
        gradient *= (self._config.scale / (norm + self._config.epsilon))[:, None, None]
        return clean - gradient
