r"""Constraints on a horizon, as objects that return rows.

A horizon of H commands is the vector :math:`z = (\delta_0, v_0, \delta_1, v_1, \dots)`. Every
constraint turns itself into rows :math:`l \le A z \le u`; a nonlinear one into rows of its
linearisation at a horizon. A new constraint (an obstacle, a state-dependent speed limit) is a new
class with a `rows` method; the projection stacks whatever it is given.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from shield.errors import InvalidLimits, InvalidProblem
from shield.limits.actuator_limits import ActuatorLimits
from shield.vehicle import KinematicBicycle, LateralRows

__all__ = [
    "UNBOUNDED",
    "BoxLimit",
    "HorizonConstraint",
    "LateralLimit",
    "RateLimit",
    "Rows",
    "stack_rows",
]

UNBOUNDED = 1e30
"""A bound that is none, the infinity of OSQP."""


@dataclass(frozen=True, slots=True)
class Rows:
    """Linear rows ``lower <= matrix @ z <= upper``.

    Attributes:
        matrix: Shape (m, 2 H).
        lower: Shape (m,), -`UNBOUNDED` where there is no bound.
        upper: Shape (m,), `UNBOUNDED` where there is no bound.
    """

    matrix: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


class HorizonConstraint(Protocol):
    """Anything that bounds a horizon."""

    def rows(self, actions: NDArray[np.float64], previous: NDArray[np.float64]) -> Rows:
        """Return the rows at a horizon.

        Args:
            actions: Horizon at which to linearise [rad, m/s], shape (H, 2).
            previous: Last executed command [rad, m/s], shape (2,).
        """
        ...


class BoxLimit:
    """G1: every command in the box; 2 H rows."""

    def __init__(self, limits: ActuatorLimits) -> None:
        self._limits = limits

    def rows(self, actions: NDArray[np.float64], previous: NDArray[np.float64]) -> Rows:
        """Return the identity between the corners of the box."""
        horizon = len(actions)
        return Rows(
            np.eye(2 * horizon),
            np.tile(self._limits.low, horizon),
            np.tile(self._limits.high, horizon),
        )


class RateLimit:
    """G2: every command within one step of the one before, the first of `previous`; 2 H rows."""

    def __init__(self, limits: ActuatorLimits) -> None:
        self._limits = limits

    def rows(self, actions: NDArray[np.float64], previous: NDArray[np.float64]) -> Rows:
        """Return the first differences between the largest fall and the largest rise."""
        horizon = len(actions)
        lower = np.tile(-self._limits.fall, horizon)
        upper = np.tile(self._limits.rise, horizon)
        lower[:2] += previous
        upper[:2] += previous
        return Rows(np.eye(2 * horizon) - np.eye(2 * horizon, k=-2), lower, upper)


class LateralLimit:
    r"""G3: :math:`|v^2\tan\delta/L| \le a_{lat,max}`, linearised at a horizon; H rows.

    With :math:`c(\delta, v) = v^2\tan\delta/L` and its CasADi gradient, the row of a step is
    :math:`\nabla c\cdot z \le a_{lat,max} - c(z_0) + \nabla c\cdot z_0` on the side of the sign of
    :math:`c(z_0)`, scaled to a gradient of length one. A step whose gradient vanishes (standstill)
    has no bound.

    Raises:
        InvalidLimits: The limits have no lateral acceleration bound.
    """

    def __init__(self, limits: ActuatorLimits, horizon: int) -> None:
        if limits.max_lateral_acceleration is None:
            raise InvalidLimits("`max_lateral_acceleration` must be a number. Got None.")
        self._bound = limits.max_lateral_acceleration
        self._lateral = LateralRows(KinematicBicycle(limits.wheelbase, limits.dt), horizon)

    def linearise(
        self, actions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return gradients (H, 2), lower (H,) and upper (H,) of the scaled rows at `actions`."""
        lateral = self._lateral
        lateral.commands[:] = actions
        lateral.evaluate()
        gradient = lateral.gradient
        length = np.sqrt((gradient * gradient).sum(axis=1))
        scale = np.where(length > 0.0, length, 1.0)
        centre = (gradient * actions).sum(axis=1) - lateral.values
        positive = lateral.values >= 0.0
        moving = length > 0.0
        upper = np.where(moving & positive, (self._bound + centre) / scale, UNBOUNDED)
        lower = np.where(moving & ~positive, (centre - self._bound) / scale, -UNBOUNDED)
        return gradient / scale[:, None], lower, upper

    def rows(self, actions: NDArray[np.float64], previous: NDArray[np.float64]) -> Rows:
        """Return one row per step, with two entries each."""
        horizon = len(actions)
        gradient, lower, upper = self.linearise(actions)
        matrix = np.zeros((horizon, 2 * horizon))
        steps = np.arange(horizon)
        matrix[steps, 2 * steps] = gradient[:, 0]
        matrix[steps, 2 * steps + 1] = gradient[:, 1]
        return Rows(matrix, lower, upper)


def stack_rows(
    constraints: Sequence[HorizonConstraint],
    actions: NDArray[np.float64],
    previous: NDArray[np.float64],
) -> Rows:
    """Return the rows of all constraints, one under the other.

    Raises:
        InvalidProblem: There is no constraint.
    """
    if not constraints:
        raise InvalidProblem("`constraints` must not be empty. Got [].")
    parts = [constraint.rows(actions, previous) for constraint in constraints]
    return Rows(
        np.vstack([part.matrix for part in parts]),
        np.concatenate([part.lower for part in parts]),
        np.concatenate([part.upper for part in parts]),
    )
