"""The exact repair and check of `projection.repair`, over many horizons at once."""

import numpy as np
from numpy.typing import NDArray

from shield.limits.rounding import BAND, differences_exceed, lateral_exceeds
from shield.projection.repair import Bounds

__all__ = ["BatchBounds", "admissible", "into_rates"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Half an ulp is the error of one sum; twice that covers its two operands.
_ROUNDING = 2.0**-52


class BatchBounds:
    """The bounds as columns that broadcast against (2, B).

    Args:
        bounds: Limits.

    Attributes:
        scalars: The limits as given.
        low: Lower corner of the box, (2, 1).
        high: Upper corner of the box, (2, 1).
        rise: Largest rises in one step, (2, 1).
        fall: Largest falls in one step, (2, 1).
        inner_rise: Rises that hold whatever the rounding of a sum, (2, 1).
        inner_fall: The same of falls, (2, 1).
    """

    def __init__(self, bounds: Bounds) -> None:
        self.scalars = bounds
        side, step = bounds.max_steering, bounds.steering_step
        self.low = np.array([[-side], [bounds.min_speed]])
        self.high = np.array([[side], [bounds.max_speed]])
        self.rise = np.array([[step], [bounds.rise]])
        self.fall = np.array([[step], [bounds.fall]])
        # What rounding can add to the sum of a command in the box and a step.
        size = np.maximum(np.abs(self.low), np.abs(self.high)) + np.maximum(self.rise, self.fall)
        self.inner_rise = self.rise - size * _ROUNDING
        self.inner_fall = self.fall - size * _ROUNDING


def into_rates(bounds: BatchBounds, targets: Array, previous: Array) -> Array:
    """Move horizons step by step into box and rates.

    Args:
        bounds: Limits.
        targets: Shape (H, 2, B), finite.
        previous: Last executed commands, shape (2, B), in the box.

    Returns:
        Horizons that keep G1 and G2, exactly unless a step is of the size of a rounding error of
        the box; shape (H, 2, B).
    """
    commands = np.empty_like(targets)
    last = previous
    for step, target in enumerate(targets):
        top = np.minimum(last + bounds.inner_rise, bounds.high)
        bottom = np.maximum(last - bounds.inner_fall, bounds.low)
        np.maximum(target, bottom, out=commands[step])
        last = np.minimum(commands[step], top, out=commands[step])
    return commands


def admissible(bounds: BatchBounds, commands: Array, previous: Array) -> Mask:
    """Tell which horizons keep G1, G2 and G3 exactly.

    Args:
        bounds: Limits.
        commands: Shape (H, 2, B); values that are not finite are not admissible.
        previous: Last executed commands, shape (2, B).

    Returns:
        Shape (B,).
    """
    before = np.concatenate([previous[None], commands[:-1]])
    with np.errstate(invalid="ignore", over="ignore"):
        good = (bounds.low <= commands) & (commands <= bounds.high)
        good &= ~differences_exceed(commands, before, bounds.rise)
        good &= ~differences_exceed(before, commands, bounds.fall)
    result: Mask = np.asarray(good.all(axis=(0, 1)))
    if bounds.scalars.lateral is not None:
        _check_lateral(bounds.scalars, commands, result)
    return result


def _check_lateral(bounds: Bounds, commands: Array, result: Mask) -> None:
    """Withdraw horizons that break the lateral bound from `result`, (B,)."""
    assert bounds.lateral is not None
    candidates = np.flatnonzero(result)
    steering, speed = commands[:, 0, candidates], commands[:, 1, candidates]
    value = speed * speed * np.abs(np.tan(steering))
    worst = value.max(axis=0, initial=0.0)
    result[candidates[worst > bounds.lateral * bounds.wheelbase * (1.0 + BAND)]] = False
    # Only what lies within rounding errors of the bound needs a closer look.
    close = np.flatnonzero((worst > bounds.surely) & result[candidates])
    for step, place in np.argwhere(value[:, close] > bounds.surely).tolist():
        column = close[place]
        index = candidates[column]
        if result[index] and lateral_exceeds(
            float(steering[step, column]),
            float(speed[step, column]),
            bounds.lateral,
            bounds.wheelbase,
        ):
            result[index] = False
