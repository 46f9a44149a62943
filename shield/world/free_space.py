"""Where earlier scans looked through: what stands there now has moved there.

This is evidence of motion that needs no track: a person who steps out from beside a parked car is
part of the same run of hits, but stands in space that was seen free.
"""

import math
from collections import deque

import numpy as np

from shield.errors import Array, Mask
from shield.estimation.scan import ScannerGeometry
from shield.vehicle import carried

__all__ = ["FreeSpace"]

LOOK_BACK = (2, 5)  # [scans] 0.5 m/s show within half a second; odometry is good for as long
# A hit has to lie within the free space: behind it [m], [m/m], and beside it, in beams (two degrees
# of heading error) and in [m] (the way driven, across a flank seen at a grazing angle)
DEPTH, DEPTH_SLOPE, BESIDE, ASIDE = 0.3, 0.02, 2, 0.3
ACROSS = np.linspace(-1.0, 1.0, 9)  # of these directions
FURTHEST = 15.0  # [m] beyond which beams are too far apart to tell


class FreeSpace:
    """The ways that the last scans were free, each from where it was taken.

    Args:
        dt: Period of the scans [s].
        scanner: Where it is and where its beams point.
    """

    def __init__(self, dt: float, scanner: ScannerGeometry) -> None:
        self._dt, self._scanner = dt, scanner
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self._ways: deque[Array] = deque(maxlen=max(LOOK_BACK))
        self._poses: Array = np.zeros((0, 3))  # of the car at each scan, the newest first

    def move(self, speed: float, yaw_rate: float) -> None:
        """Go on by one period [m/s], [rad/s]."""
        self._poses[:, :2] = carried(self._poses[:, :2], speed, yaw_rate, self._dt)
        self._poses[:, 2] -= yaw_rate * self._dt

    def add(self, ranges: Array) -> None:
        """Take how far each beam looked (n,) [m]: infinite without a return, 0 if it is broken."""
        # Out of view nothing is known.
        self._ways.appendleft(np.pad(ranges, 1, constant_values=0.0))
        self._poses = np.concatenate([np.zeros((1, 3)), self._poses])[: len(self._ways)]

    def entered(self, points: Array) -> Mask:
        """Which points (n, 2) in the car's frame [m] lie in space that was seen free."""
        inside = np.zeros(len(points), np.bool_)
        angles, mount = self._scanner.angles, self._scanner.mount
        spacing = float(angles[1] - angles[0])
        for age in LOOK_BACK:
            if age > len(self._ways):
                break
            x, y, yaw = self._poses[age - 1].tolist()
            cos, sin = math.cos(yaw), math.sin(yaw)
            east, north = points[:, 0] - x, points[:, 1] - y
            ahead, left = cos * east + sin * north - mount, cos * north - sin * east
            distance = np.hypot(ahead, left)
            aside = np.maximum(np.arctan2(ASIDE, distance), BESIDE * spacing)
            spread = np.arctan2(left, ahead)[:, None] + aside[:, None] * ACROSS
            beam = (spread - angles[0]) / spacing
            beams = np.clip(np.rint(beam).astype(np.int64), -1, len(angles))
            way = self._ways[age - 1][beams + 1].min(axis=1)
            deep = way - distance > DEPTH + DEPTH_SLOPE * distance
            inside |= deep & (distance < FURTHEST)
        return inside
