r"""Exact solution of one channel's projection, a quadratic program along a chain.

G1 and G2 do not couple steering and speed, so the projection splits into two problems

.. math:: \min_x \tfrac12\sum_t (x_t - n_t)^2 \quad\text{s.t.}\quad
          l \le x_t \le h,\; -b \le x_t - x_{t-1} \le a,\; x_{-1}\text{ given.}

`solve_chain` runs the dynamic program on the value function
:math:`f_t(x) = \tfrac12 (x - n_t)^2 + \min_{-b \le x - y \le a} f_{t-1}(y)`. Its derivative is
piecewise linear and increasing: the minimum over `y` moves the part left of the minimiser
:math:`m_{t-1}` by :math:`-b`, the part right of it by :math:`+a`, and puts a flat piece between.
The optimum follows backwards: :math:`x_{t-1}` is :math:`m_{t-1}` clipped to
:math:`[x_t - a, x_t + b]`. The cost is O(H) amortised: a knot changes side rarely.

`settle_chain` is the cheap way when a solver has already found the active bounds: it solves the
equations of those bounds exactly. `is_optimal` tells whether the KKT conditions hold at a point,
by carrying the interval of possible multipliers from the last step to the first.

References:
    N. Johnson, A Dynamic Programming Algorithm for the Fused Lasso, JCGS 2013 (the same idea with
    penalties in place of bounds).
"""

import math
from collections import deque
from typing import NamedTuple

__all__ = ["ChainBounds", "active_blocks", "is_optimal", "settle_chain", "solve_chain"]

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


def active_blocks(
    guess: list[float], bounds: ChainBounds, previous: float, tolerance: float
) -> tuple[list[int], list[float], int]:
    """Read off which steps move together when the bounds active at `guess` are kept.

    Consecutive steps joined by an active rate bound form a block that moves as one. A block joined
    to `previous` or touching a box bound is fixed.

    Args:
        guess: A solver's answer, length H.
        bounds: Box and steps of the channel.
        previous: Value before the first step.
        tolerance: Distance to a bound below which it counts as active.

    Returns:
        The free block of each step, -1 if fixed; its offset, such that a step is at its offset
        plus the value of its free block; the number of free blocks.
    """
    low, high, rise, fall = bounds
    rising, falling = rise - tolerance, tolerance - fall
    touching_low, touching_high = low + tolerance, high - tolerance
    owners: list[int] = []
    offsets: list[float] = []
    blocks = start = 0
    base: float | None = previous
    offset = 0.0
    last = previous
    for step, x in enumerate(guess):
        difference = x - last
        if difference > rising:
            offset += rise
        elif difference < falling:
            offset -= fall
        else:
            blocks += _close_block(owners, offsets, start, step, blocks, base)
            base, offset, start = None, 0.0, step
        if base is None:
            if x >= touching_high:
                base = high - offset
            elif x <= touching_low:
                base = low - offset
        offsets.append(offset)
        last = x
    blocks += _close_block(owners, offsets, start, len(guess), blocks, base)
    return owners, offsets, blocks


def _close_block(
    owners: list[int],
    offsets: list[float],
    start: int,
    stop: int,
    block: int,
    base: float | None,
) -> int:
    """Fix the steps start..stop-1 at `base`, or give them to a new free block; count it."""
    if base is None:
        owners += [block] * (stop - start)
        return int(stop > start)
    owners += [-1] * (stop - start)
    for step in range(start, stop):
        offsets[step] += base
    return 0


def settle_chain(
    guess: list[float],
    targets: list[float],
    bounds: ChainBounds,
    previous: float,
    tolerance: float,
) -> list[float]:
    """Solve for the bounds that are active at `guess`: a free block is at its targets' mean.

    The same blocks as `active_blocks`, written out because this runs in every control step.

    Args:
        guess: A solver's answer, length H.
        targets: Wanted values n, length H.
        bounds: Box and steps of the channel.
        previous: Value before the first step.
        tolerance: Distance to a bound below which it counts as active.

    Returns:
        The minimiser, length H, if the active bounds were those of the optimum; else some point.
    """
    low, high, rise, fall = bounds
    rising, falling = rise - tolerance, tolerance - fall
    touching_low, touching_high = low + tolerance, high - tolerance
    solution: list[float] = []
    size = 0
    offset = total = 0.0
    last = previous
    base: float | None = previous
    for x, target in zip(guess, targets, strict=True):
        difference = x - last
        last = x
        if difference > rising:
            offset += rise
        elif difference < falling:
            offset -= fall
        else:
            if size:
                _lift(solution, size, total / size if base is None else base)
                size = 0
                offset = total = 0.0
            base = None
        if base is None:
            if x >= touching_high:
                base = high - offset
            elif x <= touching_low:
                base = low - offset
            else:
                total += target - offset
        solution.append(offset)
        size += 1
    _lift(solution, size, total / size if base is None else base)
    return solution


def _lift(solution: list[float], size: int, base: float) -> None:
    """Add `base` to the last `size` entries, in place."""
    if size == 1:
        solution[-1] += base
    else:
        solution[-size:] = [base + offset for offset in solution[-size:]]


def is_optimal(
    x: list[float],
    targets: list[float],
    bounds: ChainBounds,
    previous: float,
    tolerance: float,
) -> bool:
    r"""Tell whether `x` satisfies the KKT conditions within `tolerance`.

    With :math:`\lambda_t` the multiplier of the rate bound into step t (positive at the rising
    bound, negative at the falling one) and :math:`\nu_t` that of the box, stationarity reads
    :math:`\lambda_t = \lambda_{t+1} + (n_t - x_t) - \nu_t` with :math:`\lambda_H = 0`. The interval
    of possible :math:`\lambda_t` is carried backwards; an empty one proves that `x` is not optimal.
    """
    low, high, rise, fall = bounds
    least = most = 0.0
    later, target = x[-1], targets[-1]
    for value, next_target in zip([*x[-2::-1], previous], [*targets[-2::-1], 0.0], strict=True):
        pull, difference = target - later, later - value
        least += pull
        most += pull
        if later >= high - tolerance:
            least = -math.inf
            if later > high + tolerance:
                return False
        # No `elif`: in a box of width zero the multiplier may have either sign.
        if later <= low + tolerance:
            most = math.inf
            if later < low - tolerance:
                return False
        if difference < rise - tolerance:
            if least > tolerance:
                return False
            if most > 0.0:
                most = 0.0
        elif difference > rise + tolerance:
            return False
        if difference > tolerance - fall:
            if most < -tolerance:
                return False
            if least < 0.0:
                least = 0.0
        elif difference < -fall - tolerance:
            return False
        later, target = value, next_target
    return True
