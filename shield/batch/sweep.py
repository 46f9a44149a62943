"""Block tridiagonal systems with 2 × 2 blocks, over a batch."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["sweep"]

Array = NDArray[np.float64]


def sweep(diagonal: Array, across: Array, joints: Array, force: Array) -> Array:
    """Solve symmetric block tridiagonal systems by one forward and one backward sweep.

    The blocks on the diagonal are ``[[d1, a], [a, d2]]``, those beside it ``-diag(joint)``.

    Args:
        diagonal: Diagonal entries d, shape (H, 2, B).
        across: Entries a within a block, shape (H, B).
        joints: Joint of each step with the one before, shape (H, 2, B); the first is unused.
        force: Right-hand sides, shape (H, 2, B).

    Returns:
        The solutions, shape (H, 2, B).
    """
    horizon = len(force)
    inverses = []
    right = force.copy()
    a11, a12, a22 = diagonal[0, 0], across[0], diagonal[0, 1]
    for t in range(horizon):
        scale = 1.0 / (a11 * a22 - a12 * a12)
        i11, i12, i22 = a22 * scale, -a12 * scale, a11 * scale
        inverses.append((i11, i12, i22))
        if t + 1 < horizon:
            o1, o2 = joints[t + 1]
            y1, y2 = right[t]
            a11 = diagonal[t + 1, 0] - o1 * o1 * i11
            a12 = across[t + 1] - o1 * o2 * i12
            a22 = diagonal[t + 1, 1] - o2 * o2 * i22
            right[t + 1, 0] += o1 * (i11 * y1 + i12 * y2)
            right[t + 1, 1] += o2 * (i12 * y1 + i22 * y2)
    solution = np.empty_like(force)
    for t in range(horizon - 1, -1, -1):
        i11, i12, i22 = inverses[t]
        y1, y2 = right[t]
        if t + 1 < horizon:
            y1 = y1 + joints[t + 1, 0] * solution[t + 1, 0]
            y2 = y2 + joints[t + 1, 1] * solution[t + 1, 1]
        solution[t, 0] = i11 * y1 + i12 * y2
        solution[t, 1] = i12 * y1 + i22 * y2
    return solution
