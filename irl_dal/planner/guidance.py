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
        last_steps: How many steps a careful end takes at most; it ends where the next one would
            not lower the energy. The network undoes part of every earlier step, the last ones
            stay. The paper takes one.

    Raises:
        ValueError: A value that cannot be meant.
    """

    scale: float = 0.1
    epsilon: float = 0.3
    careful_end: bool = True
    last_steps: int = 6

    def __post_init__(self) -> None:
        if self.last_steps < 1:
            raise ValueError(f"`last_steps` must be at least 1. Got {self.last_steps}.")
        if not (math.isfinite(self.scale) and self.scale >= 0):
            raise ValueError(f"`scale` must be finite and not negative. Got {self.scale}.")
        if not (math.isfinite(self.epsilon) and self.epsilon > 0):
            raise ValueError(f"`epsilon` must be finite and positive. Got {self.epsilon}.")


SHARES = np.array([1.0, 0.5, 0.25, 0.1])
"""Of a step's length, tried at once at a careful end."""
SHARES.setflags(write=False)


class Guidance(Refinement):
    """One normalised gradient step per reverse step, several shortened ones at a careful end.

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
        if index == self._last:
            return self._descend(clean)
        self.energy_before, step = self._step(clean)
        return clean - step

    def _step(self, clean: Array) -> tuple[Array, Array]:
        """Energies (B,) and a step of Eq. dal_guidance (B, H, 2), to be subtracted."""
        energies, gradient = self._energy.evaluate(clean)
        norm: Array = np.sqrt(np.einsum("bhc,bhc->b", gradient, gradient))
        gradient *= (self._config.scale / (norm + self._config.epsilon))[:, None, None]
        return energies, gradient

    def _descend(self, clean: Array) -> Array:
        """The careful end: steps that each lower the energy as far as they can."""
        before = None
        for _ in range(self._config.last_steps):
            energies, step = self._step(clean)
            before = energies if before is None else before
            share = self._share(clean, step, energies)
            if not share.any():
                break
            clean = clean - share[:, None, None] * step
        self.energy_before = before
        return clean

    def _share(self, clean: Array, step: Array, energies: Array) -> Array:
        """Share of each plan's step that leads to the least energy, 0 where all raise it (B,)."""
        tried = clean - SHARES[:, None, None, None] * step
        found = self._energy.value(tried.reshape(-1, *clean.shape[1:])).reshape(len(SHARES), -1)
        return np.where(found.min(axis=0) < energies, SHARES[found.argmin(axis=0)], 0.0)
