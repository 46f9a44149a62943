r"""G3: the lateral acceleration, as tangents.

With :math:`c(\delta, v) = v^2\tan\delta/L` the admissible commands of one side lie below the
convex curve :math:`c = a_{lat}`, so the half-plane below a tangent of the curve lies in them: rows
that touch the curve are never looser than the bound. CasADi gives the gradient.
"""

from typing import Any

import casadi
import numpy as np
from scipy import sparse

from shield.errors import Array, InvalidLimits
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraint import UNBOUNDED, Rows
from shield.vehicle import KinematicBicycle

__all__ = ["LateralLimit"]


class LateralLimit:
    r"""G3: :math:`|v^2\tan\delta/L| \le a_{lat}`; H rows.

    The row of a step is the tangent at the point of the curve with the step's speed, or where the
    curve leaves the box: :math:`\nabla c\cdot z \le \nabla c\cdot z_b`, on the side to which the
    step steers. Every horizon that keeps the bound keeps the rows at itself.

    A CasADi call with numpy arguments costs some ten microseconds of conversions; through its
    buffer interface, which reads and writes arrays of ours, it costs about one.

    Raises:
        InvalidLimits: The limits have no lateral acceleration bound.
    """

    def __init__(self, limits: ActuatorLimits, horizon: int) -> None:
        if limits.max_lateral_acceleration is None:
            raise InvalidLimits("`max_lateral_acceleration` must be a number. Got None.")
        self._bound = limits.max_lateral_acceleration * limits.wheelbase
        self._side = limits.max_steering
        self._fastest = float(np.sqrt(self._bound / np.tan(self._side)))
        self._columns = np.arange(2 * horizon, dtype=np.int32)
        self._starts = np.arange(0, 2 * horizon + 1, 2, dtype=np.int32)
        bicycle = KinematicBicycle(limits.wheelbase, limits.dt)
        command = casadi.SX.sym("command", 2)
        gradient = casadi.gradient(bicycle.lateral_acceleration(command), command)
        self._commands, self._gradient = np.zeros((horizon, 2)), np.zeros((horizon, 2))
        # CasADi stores columns first: its (2, H) is the (H, 2) of numpy.
        self._buffer: Any
        self._buffer, self._evaluate = (
            casadi.Function("gradient", [command], [gradient]).map(horizon).buffer()
        )
        self._buffer.set_arg(0, self._commands.data)
        self._buffer.set_res(0, self._gradient.data)

    def rows(self, actions: Array, previous: Array) -> Rows:
        """Return one row per step, with two entries each."""
        steering, speed = actions[:, 0], actions[:, 1]
        size = np.abs(speed)
        angle = np.arctan2(self._bound, size * size)
        outside = angle > self._side
        touching = self._commands
        touching[:, 0] = np.copysign(np.where(outside, self._side, angle), steering)
        touching[:, 1] = np.copysign(np.where(outside, self._fastest, size), speed)
        self._evaluate()
        gradient = self._gradient.copy()
        level = (gradient * touching).sum(axis=1)
        left = touching[:, 0] > 0.0
        matrix: Any = gradient
        if len(actions) > 1:  # of a single step the gradient is the whole matrix
            entries = (gradient.ravel(), self._columns, self._starts)
            shape = (len(actions), 2 * len(actions))
            matrix = sparse.csr_matrix(entries, shape=shape, copy=False)
        return Rows(matrix, np.where(left, -UNBOUNDED, level), np.where(left, level, UNBOUNDED))
