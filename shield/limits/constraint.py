r"""Constraints on a horizon: objects that return rows, and the stack of them that a solver sees.

A horizon of H commands is the vector :math:`z = (\delta_0, v_0, \delta_1, v_1, \dots)`. Every
constraint turns itself into rows :math:`l \le A z \le u`, a nonlinear one into those of its
linearisation at a horizon. A new constraint is a class with one method `rows`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import nnls

from shield.errors import Array, InvalidProblem

__all__ = ["UNBOUNDED", "Constraint", "RowStack", "Rows"]

UNBOUNDED = 1e30  # [-] the infinity of OSQP: a bound that is none
_ACTIVE = 1e-12  # [-] slack of an active row, relative: rounding errors of a repaired command
_LARGE = 1e20  # [-] bounds from here on are none, whatever they were divided by


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Linear rows ``lower <= matrix @ z <= upper``.

    Attributes:
        matrix: Shape (m, 2 H), an array or a `scipy.sparse.csr_matrix`.
        lower, upper: Shape (m,), -`UNBOUNDED` and `UNBOUNDED` where there is no bound.
    """

    matrix: Array | sparse.csr_matrix
    lower: Array
    upper: Array


class Constraint(Protocol):
    """Anything that bounds a horizon."""

    def rows(self, actions: Array, previous: Array) -> Rows:
        """Return the rows at a horizon.

        Args:
            actions: Horizon at which to linearise [rad, m/s], shape (H, 2).
            previous: Last executed command [rad, m/s], shape (2,).
        """


class RowStack:
    """The rows of several constraints, one under the other, for a solver with a fixed pattern.

    Rows are scaled: the variables to `unit`, a step of the actuators (2,) [rad, m/s], each row to
    entries that sum up to one. The arrays are overwritten by the next `evaluate`.

    Attributes:
        row, column, value: Of each entry, scaled, in the order of CSC, shape (n,).
        starts: Index pointer of the CSC pattern, shape (2 H + 1,).
        lower, upper: Scaled bounds, shape (m,).
        norm: Unscaled rows are `norm` times the scaled ones, shape (m,).
        spans: Rows of each constraint.
    """

    def __init__(self, constraints: Sequence[Constraint], horizon: int, unit: Array) -> None:
        if not constraints:
            raise InvalidProblem("`constraints` must not be empty. Got [].")
        self._constraints = tuple(constraints)
        self._unit = np.tile(unit, horizon)
        self._horizon = horizon
        # Not at zero, where gradients may vanish and entries with them.
        start = np.tile(unit, (horizon, 1))
        self._masks: list[NDArray[np.bool_] | None] = [None] * len(self._constraints)
        self._lay_out([one.rows(start, np.zeros(2)) for one in self._constraints])

    def evaluate(self, actions: Array, previous: Array) -> tuple[bool, bool]:
        """Take over the rows at a horizon (H, 2) from a command (2,) [rad, m/s].

        Returns:
            Whether an entry of the matrix changed, and whether its pattern did.

        Raises:
            InvalidProblem: A constraint returned arrays of another shape.
        """
        changed = False
        for index, constraint in enumerate(self._constraints):
            part = constraint.rows(actions, previous)
            if part.matrix is not self._seen[index]:
                self._check(constraint, part)
                if not self._has_pattern(index, part):
                    self._lay_out([one.rows(actions, previous) for one in self._constraints])
                    return True, True
                self._seen[index] = part.matrix
                self._raw[self._places[index]] = _entries(part.matrix, self._masks[index])
                changed = True
            span = self.spans[index]
            self._low[span], self._high[span] = part.lower, part.upper
        if changed:
            self._scale()
        np.divide(self._low, self.norm, out=self.lower)
        np.divide(self._high, self.norm, out=self.upper)
        return changed, False

    def times(self, z: Array) -> Array:
        """Return A z, shape (m,)."""
        return np.asarray(np.bincount(self.row, self.value * z[self.column], len(self.norm)))

    def transposed_times(self, y: Array) -> Array:
        """Return Aᵀ y, shape (2 H,)."""
        return np.asarray(np.bincount(self.column, self.value * y[self.row], len(self._unit)))

    def excess(self, z: Array) -> Array:
        """Return by how much a scaled horizon breaks each scaled row, shape (m,), 0 if it holds."""
        value = self.times(z)
        return np.maximum(np.maximum(value - self.upper, self.lower - value), 0.0)

    def is_usable(self) -> bool:
        """Tell whether no entry is infinite or NaN, and no lower bound above its upper one."""
        return bool(np.isfinite(self.value).all() and (self.lower <= self.upper).all())

    def duality_gap(self, z: Array, goal: Array, weights: Array, y: Array) -> float:
        r"""Return how far half the weighted squared distance from `z` to `goal` is from the least.

        With the residual :math:`r = W(z - g) + A^\top y` the gap is :math:`\tfrac12 r^\top W^{-1} r
        + y_+^\top (u - Az) + y_-^\top (Az - l)`. It bounds the error of the objective for any
        multipliers `y` (m,), positive at upper bounds, as long as `z` satisfies the rows. Horizon,
        goal and the diagonal `weights` of W are scaled and of shape (2 H,).
        """
        bound = np.where(y > 0.0, self.upper, self.lower)
        bounded = np.abs(bound) < _LARGE
        if not bounded.all():
            y, bound = np.where(bounded, y, 0.0), np.where(bounded, bound, 0.0)
        residual = weights * (z - goal) + self.transposed_times(y)
        slack = np.abs(y) @ np.abs(bound - self.times(z))
        return 0.5 * float(residual @ (residual / weights)) + float(slack)

    def multipliers(self, z: Array, goal: Array, weights: Array) -> Array:
        """Return the multipliers (m,) of active rows that leave the least residual at `z`.

        The arguments are those of `duality_gap`.
        """
        value, root = self.times(z), np.sqrt(weights)
        near = _ACTIVE * (1.0 + np.abs(value))
        above, below = self.upper - value < near, value - self.lower < near
        matrix = np.zeros((len(value), len(z)))
        matrix[self.row, self.column] = self.value
        active = np.vstack([matrix[above], -matrix[below]])
        y = np.zeros(len(value))
        if len(active):
            found, _ = nnls(active.T / root[:, None], root * (goal - z))
            y[above] += found[: above.sum()]
            y[below] -= found[above.sum() :]
        return y

    def _check(self, constraint: Constraint, part: Rows) -> None:
        shapes = part.matrix.shape, part.lower.shape, part.upper.shape
        count = shapes[0][0]
        if shapes != ((count, 2 * self._horizon), (count,), (count,)):
            raise InvalidProblem(
                f"`rows` of {type(constraint).__name__} must have the shapes "
                f"(m, {2 * self._horizon}), (m,) and (m,). Got {shapes}."
            )

    def _has_pattern(self, index: int, part: Rows) -> bool:
        """Tell whether a constraint's entries are where its last ones were."""
        seen, mask = self._seen[index], self._masks[index]
        matrix: Any = part.matrix
        if seen.shape != matrix.shape or sparse.issparse(seen) != sparse.issparse(matrix):
            return False
        if mask is not None:
            return not np.any(matrix[~mask])
        pairs = (seen.indices, matrix.indices), (seen.indptr, matrix.indptr)
        return all(a is b or np.array_equal(a, b) for a, b in pairs)

    def _lay_out(self, parts: list[Rows]) -> None:
        """Make the pattern and all arrays for the rows given."""
        for constraint, part in zip(self._constraints, parts, strict=True):
            self._check(constraint, part)
        counts = [len(part.lower) for part in parts]
        ends = np.cumsum(counts).tolist()
        self.spans = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
        self._masks = [_mask(p.matrix, m) for p, m in zip(parts, self._masks, strict=True)]
        blocks = [_coordinates(p.matrix, m) for p, m in zip(parts, self._masks, strict=True)]
        row = np.concatenate([r + s.start for (r, _), s in zip(blocks, self.spans, strict=True)])
        column = np.concatenate([c for _, c in blocks])
        order = np.lexsort((row, column))
        self.row, self.column = row[order], column[order]
        self.starts = np.searchsorted(self.column, np.arange(2 * self._horizon + 1))
        cuts = np.cumsum([len(r) for r, _ in blocks])[:-1]
        self._places = np.split(np.argsort(order), cuts)
        self._seen: list[Any] = [part.matrix for part in parts]
        self._raw = np.empty(len(row))
        for part, mask, where in zip(parts, self._masks, self._places, strict=True):
            self._raw[where] = _entries(part.matrix, mask)
        self._low = np.concatenate([part.lower for part in parts])
        self._high = np.concatenate([part.upper for part in parts])
        self._scale()
        self.lower, self.upper = self._low / self.norm, self._high / self.norm

    def _scale(self) -> None:
        scaled = self._raw * self._unit[self.column]
        norm = np.bincount(self.row, np.abs(scaled), len(self._low))
        norm[norm == 0.0] = 1.0
        self.norm, self.value = norm, scaled / norm[self.row]


def _mask(matrix: Any, last: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Return where a dense block has had entries so far; None for a sparse one."""
    if sparse.issparse(matrix):
        return None
    mask: NDArray[np.bool_] = np.asarray(matrix) != 0.0
    return mask | last if last is not None and last.shape == mask.shape else mask


def _entries(matrix: Any, mask: NDArray[np.bool_] | None) -> Array:
    """Return the entries of a block in its own order."""
    return np.ravel(matrix.data if mask is None else matrix[mask])


def _coordinates(
    matrix: Any, mask: NDArray[np.bool_] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of each entry of a block in its own order."""
    if mask is not None:
        row, column = np.nonzero(mask)
        return row, column
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)), np.asarray(matrix.indices)
