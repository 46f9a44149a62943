r"""Exact solution of one channel's projection by dynamic programming, as an oracle.

G1 and G2 do not couple steering and speed. The dynamic program runs on the value function
:math:`f_t(x) = \tfrac12 (x - n_t)^2 + \min_{-b \le x - y \le a} f_{t-1}(y)`. Its derivative is
piecewise linear and increasing: the minimum over `y` moves the part left of the minimiser by
:math:`-b`, the part right of it by :math:`+a`, and puts a flat piece between. The optimum follows
backwards: each step is its minimiser clipped to what the next one allows.

References:
    N. Johnson, A Dynamic Programming Algorithm for the Fused Lasso, JCGS 2013 (the same idea with
    penalties in place of bounds).
"""

from collections import deque
from typing import NamedTuple

_Knots = deque[tuple[float, float]]


class ChainBounds(NamedTuple):
    """Bounds of one channel: box ends `low` <= `high`, positive steps `rise` and `fall`."""

    low: float
    high: float
    rise: float
    fall: float


def solve_chain(targets: list[float], bounds: ChainBounds, previous: float) -> list[float]:
    """Return the exact minimiser, up to rounding errors.

    Args:
        targets: Wanted values n, length H > 0, finite.
        bounds: Box and steps of the channel.
        previous: Value before the first step. Where no value in the box is within reach, the first
            step is the nearest end of the box.

    Returns:
        The minimiser, length H.
    """
    low, high, rise, fall = bounds
    left_end = min(max(previous - fall, low), high)
    right_end = min(max(previous + rise, low), high)
    first = targets[0]
    left: _Knots = deque([(left_end, left_end - first)])
    right: _Knots = deque([(right_end, right_end - first)])
    minima = [_split(left, right)]
    for target in targets[1:]:
        left = deque((x - fall, g) for x, g in left)
        right = deque((x + rise, g) for x, g in right)
        _cut_left(left, right, low)
        _cut_right(left, right, high)
        left = deque((x, g + x - target) for x, g in left)
        right = deque((x, g + x - target) for x, g in right)
        minima.append(_split(left, right))
    x = minima[-1]
    solution = [x]
    for minimum in reversed(minima[:-1]):
        x = min(max(minimum, x - rise), x + fall)
        solution.append(x)
    solution.reverse()
    return solution


def _split(left: _Knots, right: _Knots) -> float:
    """Move knots so that the derivative is negative left and positive right; return the root.

    Both lists run from low to high `x`. The root is pushed onto both as a knot of derivative 0.
    """
    while left and left[-1][1] > 0.0:
        right.appendleft(left.pop())
    while right and right[0][1] < 0.0:
        left.append(right.popleft())
    if not left:
        root = right[0][0]
    elif not right:
        root = left[-1][0]
    else:
        (x0, g0), (x1, g1) = left[-1], right[0]
        root = x0 if g1 <= g0 else x0 + (x1 - x0) * (-g0 / (g1 - g0))
    left.append((root, 0.0))
    right.appendleft((root, 0.0))
    return root


def _cut_left(left: _Knots, right: _Knots, low: float) -> None:
    """Restrict the function to ``x >= low``."""
    cut: tuple[float, float] | None = None
    while left and left[0][0] < low:
        cut = left.popleft()
    if cut is None:
        return
    if not left:
        right_x, right_g = right[0]
        left.append((low, _interpolate(cut, (right_x, right_g), low)))
    else:
        left.appendleft((low, _interpolate(cut, left[0], low)))


def _cut_right(left: _Knots, right: _Knots, high: float) -> None:
    """Restrict the function to ``x <= high``."""
    cut: tuple[float, float] | None = None
    while right and right[-1][0] > high:
        cut = right.pop()
    if cut is None:
        return
    if not right:
        right.append((high, _interpolate(left[-1], cut, high)))
    else:
        right.append((high, _interpolate(right[-1], cut, high)))


def _interpolate(first: tuple[float, float], second: tuple[float, float], x: float) -> float:
    """Return the derivative at `x` on the segment between two knots."""
    (x0, g0), (x1, g1) = first, second
    return g1 if x1 <= x0 else g0 + (g1 - g0) * ((x - x0) / (x1 - x0))
