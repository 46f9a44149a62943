"""G2: the largest change in one period."""

import numpy as np
from scipy import sparse

from shield.errors import Array
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraint import Rows

__all__ = ["RateLimit"]


class RateLimit:
    """G2: every one of H commands within a step of the last, the first of `previous`; 2 H rows."""

    def __init__(self, limits: ActuatorLimits, horizon: int) -> None:
        size = 2 * horizon
        ones = np.ones(size)
        differences = sparse.diags([ones, -ones[2:]], [0, -2], shape=(size, size))
        self._matrix = sparse.csr_matrix(differences)
        self._lower = np.tile(-limits.max_decrease, horizon)
        self._upper = np.tile(limits.max_increase, horizon)

    def rows(self, actions: Array, previous: Array) -> Rows:
        """Return the first differences between the largest fall and the largest rise."""
        lower, upper = self._lower.copy(), self._upper.copy()
        lower[:2] += previous
        upper[:2] += previous
        return Rows(self._matrix, lower, upper)
