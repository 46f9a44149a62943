"""G1: every command in the box."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraint import Rows

__all__ = ["BoxLimit"]


class BoxLimit:
    """G1: every command in the box; 2 H rows.

    Args:
        limits: Limits of the vehicle.
        horizon: Number of steps H.
    """

    def __init__(self, limits: ActuatorLimits, horizon: int) -> None:
        self._rows = Rows(
            sparse.identity(2 * horizon, format="csr"),
            np.tile(limits.low, horizon),
            np.tile(limits.high, horizon),
        )

    def rows(self, actions: NDArray[np.float64], previous: NDArray[np.float64]) -> Rows:
        """Return the identity between the corners of the box, whatever the horizon."""
        return self._rows
