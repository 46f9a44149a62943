r"""A scanner's geometry, and its scans without their defects.

A single short beam is rain, dust or a defect; an obstacle near enough to matter covers several
neighbouring beams. The supported minimum is

.. math:: \min_i\; \operatorname{kth}(r_i, \dots, r_{i+w-1})

the smallest, over windows of w neighbouring beams, of the k-th smallest range in the window: k
beams within w have to be that short. Beams that gave nothing count as infinitely far.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from shield.errors import (
    Array,
    InvalidLimits,
    InvalidProblem,
    Mask,
    as_array,
    check_numbers,
    check_positive,
)
from shield.vehicle import VehicleGeometry

__all__ = ["DEFAULT_SCANNER", "CleanScan", "ScanFilter", "ScannerGeometry"]

WINDOW, SUPPORT = 5, 3  # w and k: at 10 m five beams of one degree span a pedestrian
STUCK_AFTER = 5  # repetitions of a beam, or of a whole scan: half a second at 10 Hz
LEAST_WORKING = 0.5  # share of working beams in a usable scan
DRIVING = 0.1  # [m/s] a faster car sees the ranges change from scan to scan
RANGE_MARGIN = 0.5  # [m] a reading this near to the maximum range, or beyond, is no return


@dataclass(frozen=True, slots=True)
class ScannerGeometry:
    """Where a flat scanner is mounted, where its beams point and how far they reach.

    Attributes:
        beams: Number of beams n (Table II).
        field_of_view: Angle from beam 0, at the right, counter-clockwise to the last beam [rad].
        max_range: Range, and the reading where nothing returns [m].
        mount: From the rear axle forward to the scanner, in the middle of the front bumper [m].

    Raises:
        InvalidLimits: A field is not positive and finite, fewer than two beams, or a field of view
            of more than a full turn.
    """

    beams: int = 180
    field_of_view: float = math.pi
    max_range: float = 40.0
    mount: float = VehicleGeometry().front_bumper

    def __post_init__(self) -> None:
        """Check every field."""
        whole = isinstance(self.beams, (int, np.integer)) and not isinstance(self.beams, bool)
        if not whole or self.beams < 2:
            raise InvalidLimits(f"`beams` must be an integer of at least 2. Got {self.beams!r}.")
        for name in ("field_of_view", "max_range", "mount"):
            check_positive(InvalidLimits, **{name: getattr(self, name)})
        if (view := self.field_of_view) > 2.0 * math.pi:
            raise InvalidLimits(f"`field_of_view` must be at most 2 pi. Got {view!r}.")

    @property
    def angles(self) -> Array:
        """Bearings of the beams (n,) [rad], 0 ahead, positive to the left."""
        return np.linspace(-0.5 * self.field_of_view, 0.5 * self.field_of_view, self.beams)

    def returned(self, scan: Array) -> Mask:
        """Which beams of a scan (n,) [m] hit something, (n,); NaN and ranges <= 0 did not."""
        return (scan > 0.0) & (scan < self.max_range - RANGE_MARGIN)


DEFAULT_SCANNER = ScannerGeometry()


@dataclass(frozen=True, slots=True)
class CleanScan:
    """A scan without its defects.

    Attributes:
        ranges: (n,) [m]; the maximum range where nothing returned or the beam is defective.
        working: Beams that are neither silent nor stuck (n,).
        repeated: Beams whose hit has been the same, bit by bit, since the car drove (n,).
        frozen: Whether all objects have repeated for so long that the scanner counts as dead.
        usable: Whether enough beams work and the scan is not frozen.
    """

    ranges: Array
    working: Mask
    repeated: Mask
    frozen: bool
    usable: bool

    @property
    def nearest(self) -> float | None:
        """The supported minimum [m], at most the maximum range; None when the scan is unusable."""
        if not self.usable:
            return None
        width = min(WINDOW, self.ranges.size)
        windows = np.lib.stride_tricks.sliding_window_view(self.ranges, width)
        kth = min(SUPPORT, width) - 1
        return float(np.partition(windows, kth, axis=1)[:, kth].min())


class ScanFilter:
    """Finds the defects of scans.

    A beam that repeats the same range bit by bit while the scene around it changes is stuck. It is
    removed unless its neighbours are stuck with it: several beams that agree may be a car ahead at
    the own speed, and a possible obstacle is never removed. A scan with too few working beams, or
    one that repeats itself entirely while the car drives, is unusable; it stays so at standstill
    until the readings change. `max_range` is what is reported where nothing returns [m].
    """

    def __init__(self, max_range: float) -> None:
        self._max_range = max_range
        self.reset()

    def reset(self) -> None:
        """Forget earlier scans."""
        self._last: Array | None = None
        self._repeats = np.zeros(0, dtype=np.int64)
        self._repeated: Mask = np.zeros(0, dtype=np.bool_)
        self._frozen = 0

    def examine(self, scan: ArrayLike, speed: float | None = None) -> CleanScan:
        """Return the scan without its defects, and which beams have them.

        Args:
            scan: Ranges [m], shape (n,), counter-clockwise from the right; infinite or beyond
                `max_range` where nothing returns, NaN or not positive where a beam gave nothing.
            speed: Own speed [m/s], if known.

        Raises:
            InvalidProblem: `scan` is not numbers of shape (n,), n > 0; `speed` is not a number.
        """
        ranges = as_array("scan", scan)
        if ranges.ndim != 1 or ranges.size == 0:
            raise InvalidProblem(f"`scan` must have shape (n,), n > 0. Got {ranges.shape}.")
        speed = 0.0 if speed is None else speed
        check_numbers(speed=speed)
        driving = math.isfinite(speed) and abs(speed) > DRIVING
        self._count_repetitions(ranges, driving)
        stuck = self._isolated(self._repeats >= STUCK_AFTER)
        working = (ranges > 0.0) & ~stuck
        frozen = self._frozen >= STUCK_AFTER
        return CleanScan(
            ranges=np.where(working, np.minimum(ranges, self._max_range), self._max_range),
            working=working,
            repeated=self._repeated,
            frozen=frozen,
            usable=not frozen and bool(working.mean() >= LEAST_WORKING),
        )

    def _isolated(self, beams: Mask) -> Mask:
        """Return those of some beams that have too few of them nearby to be an obstacle, (n,)."""
        if not beams.any():
            return beams
        near = np.convolve(beams, np.ones(2 * WINDOW - 1), mode="same")[: beams.size]
        return beams & (near < SUPPORT)

    def _count_repetitions(self, ranges: Array, driving: bool) -> None:
        """Compare a scan (n,) with the last one that had hits."""
        hits = (ranges > 0.0) & (ranges < self._max_range)
        if self._last is None or self._last.shape != ranges.shape:
            self._repeats = np.zeros(ranges.shape, dtype=np.int64)
            self._repeated = np.zeros(ranges.shape, dtype=np.bool_)
            self._frozen = 0
            same = self._repeated
        elif hits.any() or (ranges > 0.0).all():
            same = hits & (ranges == self._last)
        else:
            return  # a silent scan says nothing: the one before it stays the reference
        # Seen against a still scene a repeated range is ordinary, so only motion counts.
        moving = np.count_nonzero(same) <= 0.5 * np.count_nonzero(hits)
        self._repeats = np.where(same, self._repeats + int(moving), 0)
        self._repeated = same & (self._repeated | driving)
        # Scattered hits may be stuck beams on an empty road; a frozen scanner shows whole objects.
        objects = hits & ~self._isolated(hits)
        whole = bool(objects.any() and same[objects].all())
        # A car that brakes to a stop before the count is full goes on counting.
        self._frozen = self._frozen + int(driving or self._frozen > 0) if whole else 0
        self._last = ranges.copy() if hits.any() else self._last
