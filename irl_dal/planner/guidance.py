"""Energy guidance of the clean estimate, Eq. dal_guidance.

| variable   | paper          |
|------------|----------------|
| `clean`    | A-hat^0_k      |
| `scale`    | w_g            |
| result     | A-tilde^0_k    |
"""

import math
from dataclasses import dataclass

import numpy as np

from irl_dal.arrays import Array
from irl_dal.planner.energy import TotalEnergy
from irl_dal.planner.sampler import Refinement
from shield.errors import check_positive, check_within


@dataclass(frozen=True, slots=True)
class GuidanceConfig:
    """How strongly the energies push."""

    # w_g (Table II): length of a step, in normalised actions over the whole chunk; 0 for none
    scale: float = 0.1
    # Added to the gradient's norm. Below it the step shrinks with the gradient instead of keeping
    # its length, so that a plan at the energy's minimum is left where it is. The paper means a
    # number that only avoids a division by zero.
    epsilon: float = 0.3
    # Largest number of steps of the final line search, which replaces the last reverse step's step:
    # each is shortened to where it lowers the energy most, and the search ends where none does. A
    # step of full length passes a steep valley and raises the energy; and the network undoes part
    # of every earlier step, but not of the last. 0 takes one step of full length, as the paper
    # does.
    max_final_iterations: int = 6

    def __post_init__(self) -> None:
        check_positive(ValueError, epsilon=self.epsilon)
        iterations = self.max_final_iterations
        check_within(ValueError, 0, math.inf, scale=self.scale, max_final_iterations=iterations)


# Of a step's length, tried at once in each iteration of the final line search
SHARES = np.array([1.0, 0.5, 0.25, 0.1])
SHARES.setflags(write=False)


class Guidance(Refinement):
    """One normalised gradient step per reverse step, and a line search at the end."""

    def __init__(self, energy: TotalEnergy, config: GuidanceConfig) -> None:
        self._energy = energy
        self._config = config

    def clean(self, clean: Array, index: int) -> Array:
        """The estimate (B, H, 2) moved towards lower energy."""
        if self._config.scale == 0.0:
            return clean
        _, step = self._step(clean)
        return clean - step

    def finish(self, clean: Array) -> tuple[Array, Array]:
        """The last estimate (B, H, 2) moved towards lower energy, and its energies (B,) before."""
        if self._config.scale == 0.0:
            return clean, np.full(len(clean), np.nan)
        before, step = self._step(clean)
        if self._config.max_final_iterations == 0:
            return clean - step, before
        energies = before
        for iteration in range(self._config.max_final_iterations):
            if iteration:
                energies, step = self._step(clean)
            share = self._best_share(clean, step, energies)
            if not share.any():
                break
            clean = clean - share[:, None, None] * step
        return clean, before

    def _step(self, clean: Array) -> tuple[Array, Array]:
        """Energies (B,) and a step of Eq. dal_guidance (B, H, 2), to be subtracted."""
        energies, gradient = self._energy.evaluate(clean)
        norm: Array = np.sqrt(np.einsum("bhc,bhc->b", gradient, gradient))
        gradient *= (self._config.scale / (norm + self._config.epsilon))[:, None, None]
        return energies, gradient

    def _best_share(self, clean: Array, step: Array, energies: Array) -> Array:
        """Share of each plan's step that leads to the least energy, 0 where all raise it (B,)."""
        tried = clean - SHARES[:, None, None, None] * step
        values = self._energy.value(tried.reshape(-1, *clean.shape[1:])).reshape(len(SHARES), -1)
        return np.where(values.min(axis=0) < energies, SHARES[values.argmin(axis=0)], 0.0)
