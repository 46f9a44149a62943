"""The road: a centre line with curvature, drawn from a random generator, and its lanes.

Curvilinear coordinates: `s` [m] along the yellow centre line, `d` [m] to its left. Traffic keeps
right: the ego's lanes lie at negative `d`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPACING = 0.5
"""Distance between two points of the centre line [m]."""

LANE_WIDTH = 3.5
"""[m], the usual width of an urban main road's lane."""

LANES_PER_DIRECTION = 2

HOME_LANE = -1.5 * LANE_WIDTH
"""`d` of the ego's own, outer lane [m]."""

PASSING_LANE = -0.5 * LANE_WIDTH
"""`d` of the inner lane of the same direction [m]."""

HALF_WIDTH = LANES_PER_DIRECTION * LANE_WIDTH
"""From the centre line to the edge [m]."""

LEAD_IN = 25.0
"""Road behind the start [m]."""

LEAD_OUT = 90.0
"""Road beyond the goal [m]: as far as the camera sees."""


@dataclass(frozen=True, slots=True)
class RoadPoint:
    """Where a point lies on the road.

    Attributes:
        s: Arc length along the centre line [m], 0 at the start.
        d: Distance to the left of the centre line [m].
        heading: Direction of the centre line there [rad].
        curvature: Of the centre line, positive to the left [1/m].
        index: Nearest point of the centre line, a hint for the next look-up.
    """

    s: float
    d: float
    heading: float
    curvature: float
    index: int


class Road:
    """A centre line sampled every 0.5 m.

    Args:
        curvature: Curvature at each point (n,) [1/m], the first one `LEAD_IN` before the start.
        length: Distance from start to goal [m].
    """

    def __init__(self, curvature: Array, length: float) -> None:
        steps = curvature * SPACING
        heading: Array = np.concatenate([[0.0], np.cumsum(0.5 * (steps[1:] + steps[:-1]))])
        midway = 0.5 * (heading[1:] + heading[:-1])
        x = np.concatenate([[0.0], np.cumsum(SPACING * np.cos(midway))])
        y = np.concatenate([[0.0], np.cumsum(SPACING * np.sin(midway))])
        self.length = length
        self.s: Array = SPACING * np.arange(len(curvature), dtype=np.float64) - LEAD_IN
        self.points: Array = np.stack([x, y], axis=1)
        self.heading: Array = heading
        self.curvature: Array = curvature.astype(np.float64)
        for array in (self.s, self.points, self.heading, self.curvature):
            array.setflags(write=False)

    @classmethod
    def generate(
        cls, rng: np.random.Generator, length: float, min_radius: float, max_radius: float
    ) -> Road:
        """Draw straights, arcs and the transitions between them.

        Every arc turns towards the heading that the road began with once it is more than 50
        degrees away from it: the road never meets itself.

        Args:
            rng: Source of the draws.
            length: Distance from start to goal [m].
            min_radius: Smallest radius of the centre line [m].
            max_radius: Largest radius of an arc [m].
        """
        total = LEAD_IN + length + LEAD_OUT
        profile = [np.zeros(int((LEAD_IN + 15.0) / SPACING))]
        heading, covered = 0.0, LEAD_IN + 15.0
        while covered < total:
            straight = np.zeros(int(rng.uniform(10.0, 45.0) / SPACING))
            radius = float(np.exp(rng.uniform(np.log(min_radius), np.log(max_radius))))
            sign = -np.sign(heading) if abs(heading) > np.deg2rad(50.0) else rng.choice([-1.0, 1.0])
            angle = rng.uniform(np.deg2rad(15.0), np.deg2rad(75.0))
            ramp = np.linspace(0.0, 1.0, int(12.0 / SPACING), endpoint=False)
            arc = np.ones(int(max(radius * angle - 12.0, 4.0) / SPACING))
            bend = sign / radius * np.concatenate([ramp, arc, ramp[::-1]])
            heading += float(bend.sum() * SPACING)
            profile += [straight, bend]
            covered += (len(straight) + len(bend)) * SPACING
        return cls(np.concatenate(profile)[: int(total / SPACING)], length)

    def locate(self, x: float, y: float, hint: int | None = None) -> RoadPoint:
        """Find the nearest point of the centre line.

        Args:
            x: Position [m].
            y: Position [m].
            hint: `index` of an earlier answer not more than 15 m away.
        """
        low, high = 0, len(self.s)
        if hint is not None:
            low, high = max(0, hint - 30), min(len(self.s), hint + 31)
        gap = self.points[low:high] - (x, y)
        index = low + int(np.argmin(np.einsum("ij,ij->i", gap, gap)))
        heading = float(self.heading[index])
        dx, dy = x - self.points[index, 0], y - self.points[index, 1]
        along = float(np.cos(heading) * dx + np.sin(heading) * dy)
        left = float(-np.sin(heading) * dx + np.cos(heading) * dy)
        curvature = float(self.curvature[index])
        return RoadPoint(
            s=float(self.s[index]) + along,
            d=left,
            heading=heading + curvature * along,
            curvature=curvature,
            index=index,
        )

    def pose(self, s: float, d: float) -> tuple[float, float, float]:
        """Position and heading (x, y, yaw) [m, m, rad] of the point at (`s`, `d`)."""
        at = np.clip(s, self.s[0], self.s[-1])
        yaw = float(np.interp(at, self.s, self.heading))
        x = float(np.interp(at, self.s, self.points[:, 0])) - d * np.sin(yaw)
        y = float(np.interp(at, self.s, self.points[:, 1])) + d * np.cos(yaw)
        return float(x), float(y), yaw

    def line(self, start: float, stop: float, d: float, step: float) -> Array:
        """Points (n, 2) [m] of the line at offset `d` from `start` to `stop`."""
        at = np.linspace(start, stop, max(2, round((stop - start) / step) + 1))
        yaw = np.interp(at, self.s, self.heading)
        x = np.interp(at, self.s, self.points[:, 0]) - d * np.sin(yaw)
        y = np.interp(at, self.s, self.points[:, 1]) + d * np.cos(yaw)
        return np.stack([x, y], axis=1)
