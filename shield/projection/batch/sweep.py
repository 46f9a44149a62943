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
    # Products of the joints that the elimination needs, for all steps at once.
    squares, mixed = joints * joints, joints[:, 0] * joints[:, 1]
    diagonal, across, right = diagonal.copy(), across.copy(), force.copy()
    swapped = diagonal[:, ::-1]
    inverses = []
    for t in range(horizon):
        d1, d2 = diagonal[t]
        scale = 1.0 / (d1 * d2 - across[t] * across[t])
        # The inverse of a block: its diagonal, and minus what is beside it.
        own, other = swapped[t] * scale, across[t] * scale
        inverses.append((own, other))
        if t + 1 < horizon:
            y, tie = right[t], joints[t + 1]
            diagonal[t + 1] -= squares[t + 1] * own
            across[t + 1] += mixed[t + 1] * other
            right[t + 1] += tie * (own * y - other * y[::-1])
    solution = np.empty_like(force)
    for t in range(horizon - 1, -1, -1):
        (own, other), y = inverses[t], right[t]
        if t + 1 < horizon:
            y += joints[t + 1] * solution[t + 1]
        np.subtract(own * y, other * y[::-1], out=solution[t])
    return solution
