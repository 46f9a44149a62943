r"""Successive linearisation of the lateral bound, each step a quadratic program.

From a horizon that the forward repair made admissible, the lateral bound is linearised and the
resulting quadratic program solved, again and again. Its answers settle on the set of active bounds
quickly and on the last digits slowly. As soon as the active bounds are right, Newton's method on
their equations gives the digits:

.. math:: \begin{bmatrix} B^\top(W + \sum_t\lambda_t\nabla^2 c_t)B & (JB)^\top \\ JB & 0
          \end{bmatrix} \begin{bmatrix} \Delta y \\ \lambda \end{bmatrix} =
          -\begin{bmatrix} B^\top W(z - n) \\ c - a_{lat,max} \end{bmatrix}

with :math:`z = o + By` the horizon written in its free blocks (see `chain.active_blocks`). The
result counts only if the KKT conditions of the whole problem hold there, checked separately;
it is then a local optimum. It is still the forward repair that makes the bounds hold exactly.
"""

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg.lapack import dgesv

from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraints import UNBOUNDED, BoxLimit, LateralLimit, RateLimit, stack_rows
from shield.projection.chain import ChainBounds, active_blocks, is_optimal
from shield.projection.repair import INWARD
from shield.projection.solvers import SolverFactory, make_solver
from shield.vehicle import KinematicBicycle, LateralRows

__all__ = ["LateralAnswer", "LateralNewton", "SuccessiveProjection"]

Array = NDArray[np.float64]

# A bound may be near without being active, or active and not near enough, so the answer of each
# program is looked at with several factors on the distances below.
_CLOSENESS = (1.0, 10.0, 0.1)
_MAX_PROGRAMS, _MAX_NEWTON = 8, 8
# In units of a channel's step: tolerance of the solver, distance to a bound that counts as active,
# error of a certified optimum. Lateral accelerations count as active from a share of their bound.
_TOLERANCE, _ACTIVE, _CERTIFIED = 3e-5, 1e-3, 1e-7
_NEAR = 1e-3


class LateralAnswer(NamedTuple):
    """Outcome of `SuccessiveProjection.solve`.

    Attributes:
        horizon: Flat horizon (2 H,), None when the solver gave nothing.
        optimal: Whether the KKT conditions were verified there.
        reason: Why it stopped early, or empty.
    """

    horizon: Array | None
    optimal: bool
    reason: str


class _System(NamedTuple):
    """What stays the same during the Newton steps of one set of active bounds.

    Attributes:
        blocks: B, shape (2 H, n).
        convex: BᵀWB, shape (n, n).
        active: Steps whose lateral bound is active, (k,).
        steering: Rows of B of their steering, (k, n).
        speed: Rows of B of their speed, (k, n).
    """

    blocks: Array
    convex: Array
    active: NDArray[np.int64]
    steering: Array
    speed: Array


class LateralNewton:
    """Newton's method on the active bounds of a horizon.

    Args:
        limits: Limits with a lateral bound.
        horizon: Number of steps H.
        weights: Diagonal of the objective, shape (2 H,).
    """

    def __init__(self, limits: ActuatorLimits, horizon: int, weights: Array) -> None:
        self._bound = (limits.max_lateral_acceleration or np.inf) * INWARD
        self._rows = LateralRows(KinematicBicycle(limits.wheelbase, limits.dt), horizon)
        self._horizon = horizon
        self._weights = weights
        low, high, rise, fall = limits.low, limits.high, limits.rise, limits.fall
        self._chains = [
            ChainBounds(float(low[i]), float(high[i]), float(rise[i]), float(fall[i]))
            for i in range(2)
        ]

    def refine(
        self, guess: Array, targets: Array, previous: tuple[float, float], closeness: float = 1.0
    ) -> Array | None:
        """Return the local optimum on the bounds active at `guess`, or None if it is not one.

        Args:
            guess: Flat horizon (2 H,).
            targets: Nominal horizon (2 H,).
            previous: Last executed command.
            closeness: Factor on the distances at which bounds count as active.
        """
        blocks, offsets = self._blocks(guess, previous, closeness)
        rows = self._rows
        rows.commands[:] = guess.reshape(self._horizon, 2)
        rows.evaluate()
        free = blocks.any(axis=1).reshape(self._horizon, 2).any(axis=1)
        active = np.flatnonzero(
            (np.abs(rows.values) >= self._bound * (1.0 - _NEAR * closeness)) & free
        )
        if active.size > blocks.shape[1]:
            return None
        system = _System(
            blocks,
            blocks.T @ (self._weights[:, None] * blocks),
            active,
            blocks[2 * active],
            blocks[2 * active + 1],
        )
        point = offsets + blocks @ ((blocks.T @ (guess - offsets)) / blocks.sum(axis=0))
        multipliers = np.zeros(active.size)
        for _ in range(_MAX_NEWTON):
            step = self._newton_step(point, targets, system, multipliers)
            if step is None:
                return None
            point, multipliers = point + blocks @ step[0], step[1]
            size = np.abs(step[0]).max(initial=0.0)
            if not size < 10.0:
                return None
            # The next step would be of the size of its square.
            if size < 1e-6:
                break
        else:
            return None
        return point if self._is_optimal(point, targets, previous, active, multipliers) else None

    def _blocks(
        self, guess: Array, previous: tuple[float, float], closeness: float
    ) -> tuple[Array, Array]:
        """Return the block matrix B (2 H, blocks) and the offsets (2 H,)."""
        owners = np.empty((self._horizon, 2), dtype=np.int64)
        offsets = np.empty((self._horizon, 2))
        total = 0
        for channel, bounds in enumerate(self._chains):
            values = guess[channel::2].tolist()
            near = closeness * _ACTIVE * min(bounds.rise, bounds.fall)
            owner, offset, count = active_blocks(values, bounds, previous[channel], near)
            offsets[:, channel] = offset
            owners[:, channel] = [index + total if index >= 0 else -1 for index in owner]
            total += count
        matrix = (owners.reshape(-1, 1) == np.arange(total)).astype(np.float64)
        return matrix, offsets.ravel()

    def _newton_step(
        self, point: Array, targets: Array, system: "_System", last: Array
    ) -> tuple[Array, Array] | None:
        """Return the step of the free blocks and the new multipliers."""
        rows, active = self._rows, system.active
        rows.commands[:] = point.reshape(self._horizon, 2)
        rows.evaluate()
        values = rows.values[active]
        sign = np.sign(values)
        gradient = rows.gradient[active] * sign[:, None]
        size = system.blocks.shape[1]
        matrix = np.zeros((size + active.size, size + active.size))
        matrix[:size, :size] = system.convex
        if last.any():
            bend = rows.hessian[active] * (last * sign)[:, None, None]
            for one, first in enumerate((system.steering, system.speed)):
                across = bend[:, one, :1] * system.steering + bend[:, one, 1:] * system.speed
                matrix[:size, :size] += first.T @ across
        reduced = gradient[:, :1] * system.steering + gradient[:, 1:] * system.speed
        matrix[size:, :size] = reduced
        matrix[:size, size:] = reduced.T
        right = np.empty(size + active.size)
        right[:size] = system.blocks.T @ (self._weights * (targets - point))
        right[size:] = self._bound - np.abs(values)
        if not right.size:
            return right, right
        solution, info = dgesv(matrix, right, overwrite_a=True, overwrite_b=True)[2:]
        # Zero on a pivot: the active bounds depend on each other.
        return None if info else (solution[:size], solution[size:])

    def _is_optimal(
        self,
        point: Array,
        targets: Array,
        previous: tuple[float, float],
        active: NDArray[np.int64],
        multipliers: Array,
    ) -> bool:
        """Check feasibility and the signs of all multipliers.

        A lateral multiplier pulls at both channels; with that pull moved into the targets, each
        channel has to be optimal by itself.
        """
        rows = self._rows
        rows.commands[:] = point.reshape(self._horizon, 2)
        rows.evaluate()
        if np.abs(rows.values).max() > self._bound * (1.0 + 1e-9):
            return False
        if multipliers.size and multipliers.min() < -1e-9:
            return False
        pull = np.zeros((self._horizon, 2))
        scale = multipliers * np.sign(rows.values[active])
        pull[active] = rows.gradient[active] * scale[:, None]
        effective = (targets - pull.ravel() / self._weights).reshape(self._horizon, 2)
        horizon = point.reshape(self._horizon, 2)
        return all(
            is_optimal(
                horizon[:, channel].tolist(),
                effective[:, channel].tolist(),
                bounds,
                previous[channel],
                _CERTIFIED * min(bounds.rise, bounds.fall),
            )
            for channel, bounds in enumerate(self._chains)
        )


class SuccessiveProjection:
    """Persistent workspace for G1, G2 and linearised G3.

    The solver sees every channel in units of its step.

    Args:
        limits: Limits with a lateral bound.
        horizon: Number of steps H.
        solver: As in `make_solver`.
        weights: Weights of steering and speed.
        deadline: Longest time for one quadratic program [s].
    """

    def __init__(
        self,
        limits: ActuatorLimits,
        horizon: int,
        solver: str | SolverFactory,
        weights: tuple[float, float],
        deadline: float,
    ) -> None:
        start = np.tile([0.1 * limits.max_steering, 0.5 * limits.max_speed + 0.1], (horizon, 1))
        self._limits = limits
        self._lateral = LateralLimit(limits, horizon)
        rows = stack_rows([BoxLimit(limits), RateLimit(limits), self._lateral], start, np.zeros(2))
        self._matrix = sparse.csc_matrix(rows.matrix)
        column = np.repeat(np.arange(2 * horizon), np.diff(self._matrix.indptr))
        # Where in the CSC data the two entries of each lateral row live, in step order.
        lateral = np.flatnonzero(self._matrix.indices >= 4 * horizon)
        self._entries = lateral[np.argsort(column[lateral])]
        self._first = 4 * horizon
        self._horizon = horizon
        unit = np.minimum(limits.rise, limits.fall)
        self._unit, self._scale = unit, np.tile(unit, horizon)
        self._low = rows.lower / np.concatenate([self._scale, self._scale, np.ones(horizon)])
        self._high = rows.upper / np.concatenate([self._scale, self._scale, np.ones(horizon)])
        diagonal = np.tile(weights * unit**2, horizon)
        diagonal /= diagonal.max()
        self._pull = -diagonal / self._scale
        self._solver = make_solver(solver, diagonal, self._matrix, _TOLERANCE, deadline)
        self._newton = LateralNewton(limits, horizon, np.tile(weights, horizon))

    def reset(self) -> None:
        """Forget earlier problems."""
        self._solver.reset()

    def solve(
        self, targets: Array, start: Array, previous: tuple[float, float], stop_at: float
    ) -> LateralAnswer:
        """Approach the nearest horizon within G1, G2 and G3.

        Args:
            targets: Nominal horizon, shape (2 H,).
            start: Admissible horizon to start from, shape (2 H,).
            previous: Last executed command, from which `start` is admissible.
            stop_at: `time.perf_counter` after which no further program is started.
        """
        q, reason = self._pull * targets, ""
        self._set_previous(np.array(previous))
        point = start
        for _ in range(_MAX_PROGRAMS):
            if time.perf_counter() > stop_at:
                return LateralAnswer(point, False, "stopped at the deadline")
            self._linearise(point)
            answer, reason = self._solver.solve(q, self._low, self._high, self._matrix.data)
            if answer is None:
                return LateralAnswer(None, False, reason)
            answer = answer * self._scale
            moved = float(np.abs((answer - point) / self._scale).max())
            if not moved < np.inf:
                return LateralAnswer(None, False, "the solver's answer is not finite")
            point = answer
            for closeness in _CLOSENESS:
                refined = self._newton.refine(point, targets, previous, closeness)
                if refined is not None:
                    return LateralAnswer(refined, True, "")
            if reason or moved < _TOLERANCE:
                break
        return LateralAnswer(point, False, reason or "the optimum could not be verified")

    def _set_previous(self, previous: Array) -> None:
        """Write the first rate rows."""
        row = 2 * self._horizon
        self._low[row : row + 2] = (previous - self._limits.fall) / self._unit
        self._high[row : row + 2] = (previous + self._limits.rise) / self._unit

    def _linearise(self, point: Array) -> None:
        """Write the lateral rows, scaled to entries of length one."""
        first = self._first
        gradient, low, high = self._lateral.linearise(point.reshape(self._horizon, 2))
        gradient = gradient * self._unit
        length = np.maximum(np.sqrt((gradient * gradient).sum(axis=1)), 1e-9)
        self._matrix.data[self._entries] = (gradient / length[:, None]).ravel()
        self._low[first:] = np.maximum(low / length, -UNBOUNDED)
        self._high[first:] = np.minimum(high / length, UNBOUNDED)
