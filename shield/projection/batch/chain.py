r"""The dynamic program of `shield.projection.chain`, over many chains at once.

The derivative of the value function is kept as *unsorted* knots (x, g), one row per knot: being
increasing, the knot before its root is the largest x, and the largest g, among the negative ones.
So no chain needs its own insertion position, and every operation is one over all chains.
"""

import numpy as np
from numpy.typing import NDArray

__all__ = ["solve_chains"]

Array = NDArray[np.float64]


def solve_chains(
    targets: Array, low: Array, high: Array, rise: Array, fall: Array, previous: Array
) -> Array:
    """Return the exact minimisers of N chains, up to rounding errors.

    Args:
        targets: Wanted values, shape (H, N), finite.
        low: Smallest values, shape (N,).
        high: Largest values, shape (N,).
        rise: Largest rises in one step, shape (N,).
        fall: Largest falls in one step, shape (N,).
        previous: Values before the first step, shape (N,).

    Returns:
        The minimisers, shape (H, N).
    """
    horizon, chains = targets.shape
    knots = np.empty((2 * horizon, chains))
    slopes = np.empty((2 * horizon, chains))
    knots[0] = np.clip(previous - fall, low, high)
    knots[1] = np.clip(previous + rise, low, high)
    np.subtract(knots[:2], targets[0], out=slopes[:2])
    minima = np.empty((horizon, chains))
    for step in range(horizon):
        used = 2 * (step + 1)
        x, g = knots[:used], slopes[:used]
        minima[step], negative = _root(x, g)
        _into_box(x, g, minima[step], negative, low, high)
        if step + 1 == horizon:
            break
        x += np.where(negative, -fall, rise)
        np.subtract(minima[step], fall, out=knots[used])
        np.add(minima[step], rise, out=knots[used + 1])
        x, g = knots[: used + 2], slopes[: used + 2]
        g[used:] = 0.0
        g += x
        g -= targets[step + 1]
    solution = np.empty((horizon, chains))
    solution[-1] = minima[-1]
    for step in range(horizon - 2, -1, -1):
        later = solution[step + 1]
        np.clip(minima[step], later - rise, later + fall, out=solution[step])
    return solution


def _root(x: Array, g: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return where each derivative changes sign, (N,), and which knots are before it, (K, N)."""
    negative = g < 0.0
    x0 = np.where(negative, x, -np.inf).max(axis=0)
    g0 = np.where(negative, g, -np.inf).max(axis=0)
    x1 = np.where(negative, np.inf, x).min(axis=0)
    g1 = np.where(negative, np.inf, g).min(axis=0)
    with np.errstate(invalid="ignore"):
        root = x0 + (x1 - x0) * (g0 / (g0 - g1))
    # All knots on one side: the root is at the end of the domain.
    root = np.where(np.isinf(g0), x1, root)
    return np.where(np.isinf(g1), x0, root), negative


def _into_box(
    x: Array, g: Array, root: Array, negative: NDArray[np.bool_], low: Array, high: Array
) -> None:
    """Move roots outside the box to its end, and restrict those derivatives to the box.

    A derivative may extend beyond the box as long as its root lies inside: only then is what is
    beyond ever looked at.
    """
    above = root > high
    columns = np.flatnonzero(above | (root < low))
    if not columns.size:
        return
    # Below the box it is the mirror image.
    above = above[columns]
    sign = np.where(above, 1.0, -1.0)
    end = np.where(above, high[columns], low[columns])
    some_x, some_g = _cut(sign * x[:, columns], sign * g[:, columns], sign * end)
    x[:, columns], g[:, columns] = sign * some_x, sign * some_g
    root[columns], negative[:, columns] = end, above


def _cut(x: Array, g: Array, high: Array) -> tuple[Array, Array]:
    """Restrict derivatives to ``x <= high``: knots beyond move onto the end, with its value.

    There is a knot on either side: those of the last root lie in the box, and the root beyond it.
    """
    beyond = x > high
    x0 = np.where(beyond, -np.inf, x).max(axis=0)
    g0 = np.where(beyond, -np.inf, g).max(axis=0)
    x1 = np.where(beyond, x, np.inf).min(axis=0)
    g1 = np.where(beyond, g, np.inf).min(axis=0)
    value = g0 + (g1 - g0) * ((high - x0) / (x1 - x0))
    return np.where(beyond, high, x), np.where(beyond, value, g)
