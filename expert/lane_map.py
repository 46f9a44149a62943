"""Where the LiDAR's points lie in the lanes ahead.

A lane sensor's clothoid and a scan become, for each lane, the free distance ahead and whether
something is beside the car.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from shield import LaneEstimate, ScannerGeometry

Array = NDArray[np.float64]

BEHIND, AHEAD = 2.0, 40.0  # Stretch of lane that the map covers, from the rear axle [m]
# Between the points of the lane's centre line [m]: its tangents turn by at most 0.1 rad there
SPACING = 1.0


@dataclass(frozen=True, slots=True)
class LaneMap:
    """Scan points in curvilinear coordinates of the home lane."""

    s: Array  # Distance along the lane from the scanner (n,) [m]
    d: Array  # Offset to the left of the home lane's centre (n,) [m]
    lane: LaneEstimate  # The lane that they were placed in
    mount: float  # From the rear axle to the scanner [m]

    def without(self, s: float, d: float, radius: float) -> Self:
        """The map without the points around (s, d) [m]."""
        keep = np.hypot(self.s - s, self.d - d) > radius
        return replace(self, s=self.s[keep], d=self.d[keep])

    def heading_at(self, s: float) -> float:
        """Direction of the lane at `s` [m] from the scanner, relative to the car's [rad]."""
        lane, along = self.lane, s + self.mount
        return lane.curvature * along + 0.5 * lane.curvature_rate * along**2 - lane.heading_error

    @classmethod
    def build(cls, scan: Array, lane: LaneEstimate, scanner: ScannerGeometry) -> Self:
        """Place the points of a scan (beams,) [m], beam 0 at the right, in the home lane."""
        ranges = np.asarray(scan, dtype=np.float64)
        hit = scanner.returned(ranges)
        bearing = scanner.angles[hit]
        points = ranges[hit, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        points[:, 0] += scanner.mount
        return cls.place(points, lane, scanner.mount)

    @classmethod
    def place(cls, points: Array, lane: LaneEstimate, mount: float) -> Self:
        """Place points (n, 2) [m] in the frame of the rear axle in the home lane.

        `mount` leads from there to the scanner [m].
        """
        along = np.arange(-BEHIND, AHEAD + SPACING, SPACING)
        heading = lane.curvature * along + 0.5 * lane.curvature_rate * along**2 - lane.heading_error
        step = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        centre = SPACING * (np.cumsum(step, axis=0) - 0.5 * step)
        aside = np.sin(lane.heading_error), np.cos(lane.heading_error)
        foot = -lane.lateral_offset * np.array(aside)
        centre += foot - centre[round(BEHIND / SPACING)]
        gap = points[:, None, :] - centre[None, :, :]
        nearest = np.argmin(np.einsum("nmk,nmk->nm", gap, gap), axis=1)
        rows = np.arange(len(points))
        tangent, rest = step[nearest], gap[rows, nearest]
        s = along[nearest] + np.einsum("nk,nk->n", tangent, rest)
        d = tangent[:, 0] * rest[:, 1] - tangent[:, 1] * rest[:, 0]
        return cls(s - mount, d, lane, mount)

    def gap(self, centre: float, half_width: float, start: float = 0.0) -> float:
        """Free distance from `start` on [m] in the strip around offset `centre` [m]."""
        return self._first(np.abs(self.d - centre) < half_width, start)

    def gap_on_the_way(self, offset: float, goal: float, slope: float, half_width: float) -> float:
        """Free distance from the scanner in the strip that a change of lane sweeps [m].

        It goes from `offset` to `goal` [m], `slope` sideways per forward movement.
        """
        reach = slope * np.maximum(self.s, 0.0)
        way = offset + np.clip(goal - offset, -reach, reach)
        return self._first(np.abs(self.d - way) < half_width, 0.0)

    def _first(self, inside: NDArray[np.bool_], start: float) -> float:
        ahead = self.s[inside & (self.s > start)]
        return float(ahead.min()) if ahead.size else float("inf")
