"""G1: the box of steering and speed."""

import numpy as np
from scipy import sparse

from shield.errors import Array
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraint import Rows

__all__ = ["BoxLimit"]


class BoxLimit:
    """G1: every one of H commands in the box; 2 H rows."""

    def __init__(self, limits: ActuatorLimits, horizon: int) -> None:
        identity = sparse.identity(2 * horizon, format="csr")
        self._rows = Rows(identity, np.tile(limits.low, horizon), np.tile(limits.high, horizon))

    def rows(self, actions: Array, previous: Array) -> Rows:
        """Return the identity between the corners of the box, whatever the horizon."""
        return self._rows
