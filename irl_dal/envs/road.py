"""The road: a centre line with curvature and the width to both sides of it.

Curvilinear coordinates: `s` [m] along the yellow centre line, `d` [m] to its left. Traffic keeps
right: the ego's two lanes lie at negative `d`, the edge of the road 7 m to the right of the line.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from irl_dal.arrays import Array
from shield import LaneGeometry

SPACING = 0.5  # Distance between two points of the centre line [m]
LANES = LaneGeometry()  # Home and passing lane, measured from the home lane's centre
LANE_WIDTH = LANES.width  # [m]
HOME_LANE = -1.5 * LANE_WIDTH  # `d` of the ego's own, outer lane [m]
PASSING_LANE = -0.5 * LANE_WIDTH  # `d` of the inner lane of the same direction [m]
# From the centre line to the right-hand edge, on generated roads to both edges [m]
HALF_WIDTH = 2.0 * LANE_WIDTH
LEAD_IN = 25.0  # Road behind the start [m]
LEAD_OUT = 90.0  # Road beyond the goal [m]: as far as the camera sees
MAX_ATTEMPTS = 200  # Roads drawn before giving up; about one in thirty of 500 m meets itself
# Radii of the arcs [m]: at 25 m the home lane inside has 20 m, 3.2 m/s^2 at 8 m/s
MIN_RADIUS, MAX_RADIUS = 25.0, 200.0
STRAIGHTS = (10.0, 45.0)  # Length of a straight between two bends [m]
# Length over which the curvature of a bend rises and falls, and of its shortest arc [m]
TRANSITION, MIN_ARC = 15.0, 4.0
TURNS = np.deg2rad((15.0, 75.0))  # Change of direction of a bend [rad]
# Away from the first heading [rad]: then the next bend leads back to it, so that few roads meet
# themselves
MAX_HEADING = np.deg2rad(50.0)
# Points this far apart along the road [m] keep this distance on the ground [m]: two roads of
# 14 m and 4 m between them
APART, KEPT = 60.0, 32.0
HINT_REACH = 30  # Points of the centre line on both sides of a hint that are searched: 15 m
# Smallest ratio of lengths at an offset and on the centre line: beyond the centre of a bend there
# is none
MIN_STRETCH = 0.2


@dataclass(frozen=True, slots=True)
class RoadPoint:
    """Where a point lies on the road."""

    s: float  # Arc length along the centre line [m], 0 at the start
    d: float  # Distance to the left of the centre line [m]
    heading: float  # Direction of the centre line there [rad]
    curvature: float  # Of the centre line, positive to the left [1/m]
    index: int  # Nearest point of the centre line, a hint for the next look-up
    left_edge: float = HALF_WIDTH  # `d` of the left-hand edge there [m]


class Road:
    """A centre line sampled every 0.5 m.

    Args:
        points: Centre line (n, 2) [m], the first point `LEAD_IN` before the start.
        heading: Its direction (n,) [rad], without jumps of 2 pi.
        curvature: Its curvature (n,) [1/m].
        length: Distance from start to goal [m].
        left_edge: `d` of the left-hand edge (n,) [m], or of all of it.
    """

    def __init__(
        self,
        points: Array,
        heading: Array,
        curvature: Array,
        length: float,
        left_edge: float | Array = HALF_WIDTH,
    ) -> None:
        self.length = length
        self.s: Array = SPACING * np.arange(len(curvature), dtype=np.float64) - LEAD_IN
        self.points: Array = np.array(points, dtype=np.float64)
        self.heading: Array = np.array(heading, dtype=np.float64)
        self.curvature: Array = np.array(curvature, dtype=np.float64)
        self.left_edge: Array = np.full(len(curvature), left_edge)
        for array in (self.s, self.points, self.heading, self.curvature, self.left_edge):
            array.setflags(write=False)

    @classmethod
    def generate(cls, rng: np.random.Generator, length: float) -> Self:
        """Draw straights, arcs and transitions until the road meets itself nowhere.

        `ValueError` if `MAX_ATTEMPTS` roads met themselves.
        """
        for _ in range(MAX_ATTEMPTS):
            road = cls._from_curvature(_profile(rng, length), length)
            if road.is_simple():
                return road
        raise ValueError(
            f"`route_length` {length} m is too long: {MAX_ATTEMPTS} roads met themselves."
        )

    @classmethod
    def _from_curvature(cls, curvature: Array, length: float) -> Self:
        steps = curvature * SPACING
        heading: Array = np.concatenate([[0.0], np.cumsum(0.5 * (steps[1:] + steps[:-1]))])
        midway = 0.5 * (heading[1:] + heading[:-1])
        x = np.concatenate([[0.0], np.cumsum(SPACING * np.cos(midway))])
        y = np.concatenate([[0.0], np.cumsum(SPACING * np.sin(midway))])
        return cls(np.stack([x, y], axis=1), heading, curvature, length)

    def is_simple(self) -> bool:
        """Whether points `APART` along the road keep `KEPT` on the ground."""
        points, s = self.points[::8], self.s[::8]
        gap = np.abs(points[:, None] - points[None])
        near = np.einsum("ijk,ijk->ij", gap, gap) < KEPT**2
        return not bool((near & (np.abs(s[:, None] - s[None]) > APART)).any())

    def locate(self, x: float, y: float, hint: int | None = None) -> RoadPoint:
        """Nearest point of the centre line; `hint` is the index of one at most 15 m away."""
        low, high = 0, len(self.s)
        if hint is not None:
            low, high = max(0, hint - HINT_REACH), min(len(self.s), hint + HINT_REACH + 1)
        gap = self.points[low:high] - (x, y)
        index = low + int(np.argmin(np.einsum("ij,ij->i", gap, gap)))
        heading = float(self.heading[index])
        dx, dy = x - self.points[index, 0], y - self.points[index, 1]
        along = float(np.cos(heading) * dx + np.sin(heading) * dy)
        left = float(-np.sin(heading) * dx + np.cos(heading) * dy)
        curvature = float(self.curvature[index])
        along /= max(MIN_STRETCH, 1.0 - curvature * left)
        return RoadPoint(
            s=float(self.s[index]) + along,
            d=left,
            heading=heading + curvature * along,
            curvature=curvature,
            index=index,
            left_edge=float(self.left_edge[index]),
        )

    def pose(self, s: float, d: float) -> tuple[float, float, float]:
        """Position and heading (x, y, yaw) [m, m, rad] of the point at (`s`, `d`)."""
        place = min(max((s - self.s[0]) / SPACING, 0.0), len(self.s) - 1.001)
        index = int(place)
        share = place - index
        yaw, x, y = (
            (1.0 - share) * float(row[index]) + share * float(row[index + 1])
            for row in (self.heading, self.points[:, 0], self.points[:, 1])
        )
        return float(x - d * np.sin(yaw)), float(y + d * np.cos(yaw)), float(yaw)

    def line(self, start: float, stop: float, d: float | Array, step: float) -> Array:
        """Points (n, 2) [m] at offset `d`, of all or of each, from `start` to `stop`."""
        at = stations(start, stop, step)
        yaw = np.interp(at, self.s, self.heading)
        x = np.interp(at, self.s, self.points[:, 0]) - d * np.sin(yaw)
        y = np.interp(at, self.s, self.points[:, 1]) + d * np.cos(yaw)
        return np.stack([x, y], axis=1)


def stations(start: float, stop: float, step: float) -> Array:
    """Equal steps of about `step` from `start` to `stop` [m], both included."""
    return np.linspace(start, stop, max(2, round((stop - start) / step) + 1))


def _profile(rng: np.random.Generator, length: float) -> Array:
    """Curvature every 0.5 m: bends that turn back to the first heading from `MAX_HEADING` on."""
    total = LEAD_IN + length + LEAD_OUT
    covered = LEAD_IN + TRANSITION
    profile = [np.zeros(int(covered / SPACING))]
    heading = 0.0
    ramp = np.linspace(0.0, 1.0, int(TRANSITION / SPACING), endpoint=False)
    while covered < total:
        straight = np.zeros(int(rng.uniform(*STRAIGHTS) / SPACING))
        radius = float(np.exp(rng.uniform(np.log(MIN_RADIUS), np.log(MAX_RADIUS))))
        sign = -np.sign(heading) if abs(heading) > MAX_HEADING else rng.choice([-1.0, 1.0])
        angle = rng.uniform(*TURNS)
        arc = np.ones(int(max(radius * angle - TRANSITION, MIN_ARC) / SPACING))
        bend = sign / radius * np.concatenate([ramp, arc, ramp[::-1]])
        heading += float(bend.sum() * SPACING)
        profile += [straight, bend]
        covered += (len(straight) + len(bend)) * SPACING
    return np.concatenate(profile)[: int(total / SPACING)]
