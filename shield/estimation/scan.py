r"""The nearest obstacle in a scan that neighbouring beams agree on.

A single short beam is rain, dust or a defect; an obstacle near enough to matter covers several
neighbouring beams. The supported minimum is

.. math:: \min_i\; \operatorname{kth}(r_i, \dots, r_{i+w-1})

the smallest, over windows of w neighbouring beams, of the k-th smallest range in the window: k
beams within w have to be that short. Beams that gave nothing count as infinitely far.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.arguments import as_array, check_positive, is_number
from shield.errors import InvalidLimits, InvalidProblem
from shield.vehicle import VehicleGeometry

__all__ = ["DEFAULT_SCANNER", "ScanFilter", "ScannerGeometry"]

Array = NDArray[np.float64]

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
        if not isinstance(self.beams, (int, np.integer)) or isinstance(self.beams, bool):
            raise InvalidLimits(f"`beams` must be an integer. Got {self.beams!r}.")
        if self.beams < 2:
            raise InvalidLimits(f"`beams` must be at least 2. Got {self.beams!r}.")
        check_positive(
            InvalidLimits,
            field_of_view=self.field_of_view,
            max_range=self.max_range,
            mount=self.mount,
        )
        if self.field_of_view > 2.0 * math.pi:
            raise InvalidLimits(
                f"`field_of_view` must be at most 2 pi. Got {self.field_of_view!r}."
            )

    @property
    def angles(self) -> Array:
        """Bearings of the beams (n,) [rad], 0 ahead, positive to the left."""
        return np.linspace(-0.5 * self.field_of_view, 0.5 * self.field_of_view, self.beams)

    def returned(self, scan: Array) -> NDArray[np.bool_]:
        """Which beams of a scan (n,) [m] hit something, (n,); NaN and ranges <= 0 did not."""
        return (scan > 0.0) & (scan < self.max_range - RANGE_MARGIN)


DEFAULT_SCANNER = ScannerGeometry()


class ScanFilter:
    """Cleans scans and finds their supported minimum.

    A beam that repeats the same range bit by bit while the scene around it changes is stuck, and
    ignored unless its neighbours are stuck with it: several beams that agree may be a car ahead at
    the own speed, and what may be an obstacle is never ignored. A scan with too few working beams,
    or one that repeats itself entirely while the car drives, counts as missing.

    Args:
        max_range: Largest range, reported where nothing returns [m].
        window: Neighbouring beams w that are looked at together.
        support: Beams k among them that have to agree.
        stuck_after: Repetitions after which a beam is stuck, or a whole scan dead.
        least_working: Smallest share of working beams in a usable scan.
    """

    def __init__(
        self,
        max_range: float,
        *,
        window: int = 5,
        support: int = 3,
        stuck_after: int = 5,
        least_working: float = 0.5,
    ) -> None:
        if not 1 <= support <= window:
            raise InvalidProblem(f"`support` must lie in [1, {window}]. Got {support!r}.")
        self._max_range = max_range
        self._window, self._support = window, support
        self._stuck_after, self._least_working = stuck_after, least_working
        self.reset()

    def reset(self) -> None:
        """Forget earlier scans."""
        self._last: Array | None = None
        self._repeats = np.zeros(0, dtype=np.int64)
        self._frozen = 0

    def nearest(self, scan: ArrayLike, speed: float | None = None) -> float | None:
        """Return the supported minimum.

        Args:
            scan: Ranges [m], shape (n,).
            speed: Own speed [m/s], if known.

        Returns:
            The range [m], at most `max_range`; None when the scan is unusable.

        Raises:
            InvalidProblem: `scan` is not of numbers, not one-dimensional or empty; `speed` is not a
                number.
        """
        usable = self.clean(scan, speed)
        if usable is None:
            return None
        width = min(self._window, usable.size)
        windows = np.lib.stride_tricks.sliding_window_view(usable, width)
        kth = min(self._support, width) - 1
        return float(np.partition(windows, kth, axis=1)[:, kth].min())

    def clean(self, scan: ArrayLike, speed: float | None = None) -> Array | None:
        """Return the ranges with `max_range` where a beam is of no use, or None.

        Args:
            scan: Ranges [m], shape (n,).
            speed: Own speed [m/s], if known.

        Returns:
            Ranges [m], shape (n,), at most `max_range`; None when the scan is unusable.

        Raises:
            InvalidProblem: `scan` is not of numbers, not one-dimensional or empty; `speed` is not a
                number.
        """
        ranges = as_array("scan", scan)
        if ranges.ndim != 1 or ranges.size == 0:
            raise InvalidProblem(f"`scan` must have shape (n,), n > 0. Got {ranges.shape}.")
        if speed is not None and not is_number(speed):
            raise InvalidProblem(f"`speed` must be a number or None. Got {speed!r}.")
        working = ranges > 0.0
        stuck, dead = self._watch(ranges, speed)
        working &= ~self._isolated(stuck)
        if dead or working.mean() < self._least_working:
            return None
        return np.where(working, np.minimum(ranges, self._max_range), self._max_range)

    def _isolated(self, stuck: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the stuck beams with too few stuck neighbours to be an obstacle, (n,)."""
        if not stuck.any():
            return stuck
        near = np.convolve(stuck, np.ones(2 * self._window - 1), mode="same")[: stuck.size]
        return stuck & (near < self._support)

    def _watch(self, ranges: Array, speed: float | None) -> tuple[NDArray[np.bool_], bool]:
        """Return which beams are stuck, and whether the whole scan is dead."""
        last, self._last = self._last, ranges.copy()
        none = np.zeros(ranges.shape, dtype=bool)
        if last is None or last.shape != ranges.shape:
            self._repeats = np.zeros(ranges.shape, dtype=np.int64)
            self._frozen = 0
            return none, False
        hits = (ranges > 0.0) & (ranges < self._max_range)
        same = hits & (ranges == last)
        count = int(hits.sum())
        # Seen against a still scene a repeated range is ordinary, so only motion counts.
        if count and same.sum() <= 0.5 * count:
            self._repeats = np.where(same, self._repeats + 1, 0)
        else:
            self._repeats[~same] = 0
        driving = speed is not None and math.isfinite(speed) and abs(speed) > 0.5
        self._frozen = self._frozen + 1 if driving and count and same.sum() == count else 0
        return self._repeats >= self._stuck_after, self._frozen >= self._stuck_after
