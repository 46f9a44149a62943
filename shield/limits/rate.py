"""G2: every command within one step of the one before."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraint import Rows

__all__ = ["RateLimit"]


class RateLimit:
    """G2: every command within one step of the one before, the first of `previous`; 2 H rows.

    Args:
        limits: Limits of the vehicle.
        horizon: Number of steps H.
    """

    def __init__(self, limits: ActuatorLimits, horizon: int) -> None:
        size = 2 * horizon
        ones = np.ones(size)
        self._matrix = sparse.csr_matrix(
            sparse.diags([ones, -ones[2:]], [0, -2], shape=(size, size))
        )
        self._lower = np.tile(-limits.max_decrease, horizon)
        self._upper = np.tile(limits.max_increase, horizon)

    def rows(self, actions: NDArray[np.float64], previous: NDArray[np.float64]) -> Rows:
        """Return the first differences between the largest fall and the largest rise."""
        lower, upper = self._lower.copy(), self._upper.copy()
        lower[:2] += previous
        upper[:2] += previous
        return Rows(self._matrix, lower, upper)
