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
        careful_end: Whether the last step is shortened to where it lowers the energy most, or not
            taken. Where the energy is steep a step of full length goes past the valley: the plan's
            energy then rises by it. The paper takes the full length.

    Raises:
        ValueError: A value that cannot be meant.
    """

    scale: float = 0.1
    epsilon: float = 0.3
    careful_end: bool = True

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale >= 0):
            raise ValueError(f"`scale` must be finite and not negative. Got {self.scale}.")
        if not (math.isfinite(self.epsilon) and self.epsilon > 0):
            raise ValueError(f"`epsilon` must be finite and positive. Got {self.epsilon}.")


FRACTIONS = np.array([1.0, 0.5, 0.25, 0.1])
"""Of the step's length, tried at once at a careful end."""
FRACTIONS.setflags(write=False)


class Guidance(Refinement):
    """One normalised gradient step per reverse step.

    Args:
        energy: Composite energy of this context.
        config: Step length.
        last: Index of the last reverse step; None where every step is like the others.

    Attributes:
        energy_before: Energies (B,) of the last estimate before its step; None at first.
    """

    def __init__(
        self, energy: TotalEnergy, config: GuidanceConfig, last: int | None = None
    ) -> None:
        self._energy = energy
        self._config = config
        self._last = last if config.careful_end else None
        self.energy_before: Array | None = None

    def clean(self, clean: Array, index: int) -> Array:
        """The estimate (B, H, 2) moved towards lower energy."""
        self.energy_before, gradient = self._energy.evaluate(clean)
        norm: Array = np.sqrt(np.einsum("bhc,bhc->b", gradient, gradient))
        gradient *= (self._config.scale / (norm + self._config.epsilon))[:, None, None]
        if index == self._last:
            gradient *= self._fraction(clean, gradient)[:, None, None]
        return clean - gradient

    def _fraction(self, clean: Array, step: Array) -> Array:
        """Share of each plan's step that leads to the least energy, 0 where all raise it (B,)."""
        assert self.energy_before is not None
        tried = clean - FRACTIONS[:, None, None, None] * step
        energies = self._energy.value(tried.reshape(-1, *clean.shape[1:]))
        energies = energies.reshape(len(FRACTIONS), -1)
        best = energies.argmin(axis=0)
        return np.where(energies.min(axis=0) < self.energy_before, FRACTIONS[best], 0.0)
