"""Batches of horizons from end to end: what passes, what is projected, what is left over."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shield.projection.batch.chain import solve_chains
from shield.projection.batch.lateral import LateralBatch
from shield.projection.batch.repair import BatchBounds, admissible, into_rates
from shield.projection.repair import Bounds

__all__ = ["BatchEngine", "BatchOutcome"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Values per array that stay in the cache of one core while a step works on them.
_CACHED = 20_000

# Fewer bent horizons than this are solved faster one by one.
_WORTHWHILE = 12


class BatchOutcome(NamedTuple):
    """What the engine made of a batch.

    Attributes:
        actions: Horizons, shape (B, H, 2); meaningful where `nominal` or `solved`.
        nominal: Which horizons were admissible and came back bit by bit, (B,).
        solved: Which horizons were projected and checked, (B,). The rest is left to the caller:
            values that are not finite or huge, inadmissible previous commands, no convergence, and
            bent horizons too few to be worth a batch.
    """

    actions: Array
    nominal: Mask
    solved: Mask


class BatchEngine:
    """Projects batches without a loop over horizons.

    G1 and G2 go through the dynamic program, horizons that then break the lateral bound through
    the interior point method, everything through the exact repair and the exact check.

    Args:
        bounds: Limits.
        horizon: Number of steps H.
        weights: Weights of steering and speed.
        reach: Size of targets beyond which a horizon is left to the caller.
    """

    def __init__(
        self, bounds: Bounds, horizon: int, weights: tuple[float, float], reach: float
    ) -> None:
        self._bounds = BatchBounds(bounds)
        self._lateral = None if bounds.lateral is None else LateralBatch(bounds, weights)
        self._reach = reach
        self._chunk = max(64, _CACHED // (2 * horizon))

    def solve(self, nominals: Array, previous: Array) -> BatchOutcome:
        """Project a batch.

        Args:
            nominals: Wanted commands, shape (B, H, 2), any values.
            previous: Last executed commands, shape (B, 2), any values.
        """
        # Copies, always: a batch of one would otherwise be the caller's own memory.
        wanted = np.array(nominals.transpose(1, 2, 0), order="C")
        last = np.array(previous.T, order="C")
        nominal = admissible(self._bounds, wanted, last)
        nominal &= np.isfinite(last).all(axis=0)
        with np.errstate(invalid="ignore"):
            usable = ~nominal & (np.abs(wanted) <= self._reach).all(axis=(0, 1))
        usable &= admissible(self._bounds, last[None], last)
        index = np.flatnonzero(usable)
        goal, targets = wanted, wanted.copy()
        for part in _parts(index, self._chunk):
            goal[..., part] = self._without_lateral(targets[..., part], last[:, part])
        commands = into_rates(self._bounds, goal[..., index], last[:, index])
        good = admissible(self._bounds, commands, last[:, index])
        goal[..., index] = commands
        solved = np.zeros(len(nominals), dtype=bool)
        solved[index] = good
        bent = index[~good]
        if self._lateral is not None and bent.size >= _WORTHWHILE:
            for part in _parts(bent, 4 * self._chunk):
                some, converged = self._lateral.solve(
                    targets[..., part], goal[..., part], last[:, part]
                )
                some = into_rates(self._bounds, some, last[:, part])
                goal[..., part] = some
                solved[part] = converged & admissible(self._bounds, some, last[:, part])
        return BatchOutcome(np.ascontiguousarray(goal.transpose(2, 0, 1)), nominal, solved)

    def _without_lateral(self, targets: Array, previous: Array) -> Array:
        """Return the optima of G1 and G2 for targets (H, 2, B)."""
        bounds, shape = self._bounds, targets.shape
        low, high, rise, fall = (
            np.broadcast_to(end, previous.shape).ravel()
            for end in (bounds.low, bounds.high, bounds.rise, bounds.fall)
        )
        flat = targets.reshape(shape[0], -1)
        return solve_chains(flat, low, high, rise, fall, previous.ravel()).reshape(shape)


def _parts(index: NDArray[np.int64], size: int) -> list[NDArray[np.int64]]:
    """Return an index in parts of similar length, at most `size`."""
    return np.array_split(index, -(-index.size // size)) if index.size else []
