"""What is around the car, as one scanner in the front bumper knows it.

The scanner looks ahead only. What has gone out of its sight beside the car is remembered and moved
on with its own velocity until the car has left it behind.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.estimation.clusters import ClusterTracker, Track
from shield.estimation.scan import ScanFilter

__all__ = ["Surroundings"]

Array = NDArray[np.float64]

_PERSON = 1.0
"""Narrower than this is who walks [m]."""

_WALK = 0.5, 2.5
"""Slowest and fastest speed of somebody who walks [m/s]."""

_SURE = 5
"""Scans from which a velocity is believed."""

_CAR = 7.0
"""Longer than this is a wall or a hedge, which stands [m]."""

_FASTEST = 15.0
"""Along the car, of what is remembered beside it [m/s]; more is a mismatch of two clusters."""

_BESIDE = 3.5
"""Sideways distance up to which things are remembered [m]."""

_NEAR = 2.0
"""How far ahead of the scanner something may be and be beside the car in the next scan [m]."""


class Surroundings:
    """Points and people ahead, and what is beside the car.

    Args:
        dt: Period of the scans [s].
        forward: From the rear axle to the scanner [m].
        max_range: Reading of a beam that hit nothing [m].
        reach: How far the points are of interest [m].

    Attributes:
        points: Hits (n, 2) in the scanner's frame, x ahead, y to the left [m]; none without a
            usable scan.
        walkers: Tracks of who walks.
        beside: Remembered hits (m, 2) in the same frame, x < 0 [m].
        speed: Own speed [m/s].
    """

    def __init__(self, dt: float, *, forward: float, max_range: float, reach: float) -> None:
        self.forward = forward
        self._dt = dt
        self._farthest = min(max_range - 0.5, reach)
        self._tracker = ClusterTracker(dt, forward, width=_CAR)
        self._scan_filter = ScanFilter(max_range)
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._tracker.reset()
        self._scan_filter.reset()
        self.points: Array = np.zeros((0, 2))
        self.walkers: tuple[Track, ...] = ()
        self.beside: Array = np.zeros((0, 2))
        self.speed = 0.0
        self._pace: Array = np.zeros(0)
        self._beside_pace: Array = np.zeros(0)

    def update(self, scan: ArrayLike, speed: float, yaw_rate: float) -> None:
        """Take a scan.

        Args:
            scan: Ranges [m], shape (n,), over 180 degrees, counter-clockwise from the right.
            speed: Own speed since the last one [m/s]; the last known one if not finite.
            yaw_rate: Own yaw rate since the last one [rad/s]; 0 if not finite.

        Raises:
            InvalidProblem: `scan` is not of numbers, not one-dimensional or empty.
        """
        self.speed = float(speed) if math.isfinite(speed) else self.speed
        yaw_rate = float(yaw_rate) if math.isfinite(yaw_rate) else 0.0
        self._remember(yaw_rate)
        ranges = self._scan_filter.clean(scan, speed)
        if ranges is None:
            ranges = np.full(1, math.inf)
        hit = ranges < self._farthest
        bearing = np.linspace(-0.5 * math.pi, 0.5 * math.pi, len(ranges))[hit]
        self.points = ranges[hit, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        tracks = self._tracker.update(self.points, self.speed, yaw_rate)
        sure = [track for track in tracks if track.sightings >= _SURE]
        self._pace = np.zeros(len(self.points))
        for track in sure:
            pace = float(track.velocity[0])
            self._pace[track.first : track.last + 1] = pace if abs(pace) < _FASTEST else 0.0
        self.walkers = tuple(track for track in sure if self._walks(track))

    def _walks(self, track: Track) -> bool:
        width = math.dist(self.points[track.first], self.points[track.last])
        return width < _PERSON and _WALK[0] < math.hypot(*track.velocity.tolist()) < _WALK[1]

    def _remember(self, yaw_rate: float) -> None:
        """Move what is beside the car, and what was about to be, by one period."""
        near = (self.points[:, 0] < _NEAR) & (np.abs(self.points[:, 1]) < _BESIDE)
        points = np.concatenate([self.beside, self.points[near]])
        pace = np.concatenate([self._beside_pace, self._pace[near]])
        turn = yaw_rate * self._dt
        cos, sin = math.cos(turn), math.sin(turn)
        ahead = points[:, 0] + self.forward + (pace - self.speed) * self._dt
        moved = np.stack(
            [
                cos * ahead + sin * points[:, 1] - self.forward,
                cos * points[:, 1] - sin * ahead,
            ],
            axis=1,
        )
        # What is ahead of the scanner is seen anew.
        kept = (moved[:, 0] < 0.0) & (moved[:, 0] > -self.forward)
        self.beside, self._beside_pace = moved[kept], pace[kept]
