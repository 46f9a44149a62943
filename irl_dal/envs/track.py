"""Roads from a centre line with its widths, as `track_file` reads them.

The file's right-hand edge is the road's right-hand edge. The ego's two lanes of 3.5 m lie along it,
so that the yellow line runs 7 m to its left; what is left of the file's width is the other
direction's. A road narrower than the two lanes is widened to the left. In hairpins to the right the
lanes swing out to the left, because no car could follow the inner edge.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from irl_dal.arrays import Array
from irl_dal.envs.road import HALF_WIDTH, LEAD_IN, LEAD_OUT, SPACING, Road
from irl_dal.envs.track_file import TrackError, TrackFile

SHOULDER = 0.3  # Least width beyond the yellow line [m]
# Of the yellow line after smoothing in bends to the left, where the own lanes are wider, and to the
# right [m], where the edge is 7 m nearer to their centre
MIN_LEFT_RADIUS, MIN_RADIUS = 5.0, 8.0
# Of the yellow line in bends to the right [m], whose home lane is 5.25 m nearer to their centre:
# where the file's line is tighter, the lanes swing to the left as far as it is wide
MIN_RIGHT_RADIUS = 16.0
PUSH_LENGTH = 10.0  # Standard deviation of such a move along the road [m]
PUSHES, PUSH = 60, 0.5  # Most moves, each one's length where the line is tightest [m]: 30 m in all
EDGE_SHARE = 0.8  # The left-hand edge stays within this share of the radius of a bend to the left
MIN_SAMPLES = 4  # Fewest points of a resampled line: a periodic cubic needs them
FLAT = 1e-9  # Curvature that is none [1/m]; keeps divisions finite
SMOOTHING = 4.0  # Deviation of the Gaussian that takes the surveying noise out of the line [m]


@dataclass(frozen=True, slots=True)
class Track:
    """The whole road of a file, every 0.5 m."""

    name: str  # Of the file
    points: Array  # Yellow centre line (n, 2) [m]
    heading: Array  # Its direction (n,) [rad], without jumps
    curvature: Array  # Its curvature (n,) [1/m]
    left_edge: Array  # Distance from it to the left-hand edge (n,) [m]
    closed: bool  # Whether the last point leads to the first

    @property
    def length(self) -> float:
        """Length of the yellow line [m]."""
        return SPACING * (len(self.points) - (0 if self.closed else 1))

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file; `TrackError` if it cannot be read, or what it describes is not a road."""
        file = TrackFile.read(path)
        closed = file.closed
        stations, points, left = _yellow_line(file)
        along = _arc_length(points, closed)
        count = max(MIN_SAMPLES, round(along[-1] / SPACING))
        at = np.linspace(0.0, along[-1], count, endpoint=False)
        if not closed:
            at = np.arange(0.0, along[-1], SPACING)
        values = _closing(np.concatenate([points, left[:, None]], axis=1), closed)
        spline = CubicSpline(along, values, bc_type="periodic" if closed else "natural")
        x, first, second = spline(at), spline(at, 1), spline(at, 2)
        speed = np.hypot(first[:, 0], first[:, 1])
        curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
        heading = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
        least = np.where(curvature > 0.0, MIN_LEFT_RADIUS, MIN_RADIUS)
        sharpest = int(np.argmax(np.abs(curvature) * least))
        if abs(curvature[sharpest]) * least[sharpest] > 1.0:
            station = float(np.interp(at[sharpest], along[: len(stations)], stations))
            nearest = int(np.argmin(np.abs(_arc_length(file.points, closed=False) - station)))
            raise file.error(
                nearest,
                f"the centre line bends with a radius of {1.0 / abs(curvature[sharpest]):.1f} m; "
                f"at least {least[sharpest]:g} m are needed",
            )
        left_edge = np.minimum(x[:, 2], EDGE_SHARE / np.maximum(curvature, FLAT))
        return cls(file.path.name, x[:, :2], heading, curvature, left_edge, closed)

    def stretches(self, length: float) -> int:
        """How many goals `length` metres apart the road has; 0 where it is too short."""
        room = self.length if self.closed else self.length - LEAD_IN - LEAD_OUT
        return int(room // length) if room >= length else 0

    def stretch(self, number: int, length: float) -> Road:
        """The road to the goal of a stretch of `length` [m]; numbers go round.

        `TrackError` if the road is shorter than one stretch.
        """
        count = self.stretches(length)
        if count == 0:
            raise TrackError(
                f"{self.name}: {self.length:.0f} m of road are too short for `route_length` "
                f"{length:g} m"
            )
        first = round((number % count) * length / SPACING)
        if self.closed:
            first -= round(LEAD_IN / SPACING)
        index = first + np.arange(int((LEAD_IN + length + LEAD_OUT) / SPACING))
        laps, place = np.divmod(index, len(self.points))
        turn = round((self.heading[-1] - self.heading[0]) / (2.0 * math.pi)) * 2.0 * math.pi
        heading = self.heading[place] + laps * turn
        bend, edge = self.curvature[place], self.left_edge[place]
        return Road(self.points[place], heading, bend, length, edge)


def _closing(values: Array, closed: bool) -> Array:
    """The rows (n, k), of a closed line with the first one again at the end."""
    return np.concatenate([values, values[:1]]) if closed else values


def _arc_length(points: Array, closed: bool) -> Array:
    """Arc length (n,) of each point, (n + 1,) with the way back to the first of a closed line."""
    steps = np.linalg.norm(np.diff(_closing(points, closed), axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _yellow_line(file: TrackFile) -> tuple[Array, Array, Array]:
    """Smoothed yellow line every metre: arc length in the file (m,), points (m, 2), room left."""
    closed = file.closed
    along = _arc_length(file.points, closed)
    points, widths = _closing(file.points, closed), _closing(file.widths, closed)
    spline = CubicSpline(along, points, bc_type="periodic" if closed else "natural")
    at = np.linspace(0.0, along[-1], max(MIN_SAMPLES, round(along[-1])), endpoint=not closed)
    mode: Literal["wrap", "nearest"] = "wrap" if closed else "nearest"
    width = np.stack([np.interp(at, along, column) for column in widths.T], axis=1)
    width = gaussian_filter1d(width, 2.0 * SMOOTHING, axis=0, mode=mode)
    tangent = spline(at, 1)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    centre = spline(at)
    if closed:
        centre = gaussian_filter1d(centre, SMOOTHING, axis=0, mode="wrap")
    offset = HALF_WIDTH - width[:, 0]
    for _ in range(PUSHES):
        line = centre + offset[:, None] * normal
        tight = _right_bend(line) * MIN_RIGHT_RADIUS > 1.0
        if not tight.any():
            break
        push = gaussian_filter1d(tight.astype(float), PUSH_LENGTH, mode=mode)
        limit = np.maximum(offset, width[:, 1] - SHOULDER)
        offset = np.minimum(offset + PUSH * push / max(float(push.max()), FLAT), limit)
        offset = gaussian_filter1d(offset, SMOOTHING, mode=mode)
    left = np.maximum(width[:, 1] - offset, SHOULDER)
    return at, line, left


def _right_bend(line: Array) -> Array:
    """Curvature to the right (m,) [1/m] of points a metre apart, 0 at both ends."""
    first = np.gradient(line, axis=0)
    second = np.gradient(first, axis=0)
    turn = first[:, 1] * second[:, 0] - first[:, 0] * second[:, 1]
    bend = turn / np.maximum(np.einsum("ij,ij->i", first, first), 1e-12) ** 1.5
    bend[:2] = bend[-2:] = 0.0
    return np.asarray(np.maximum(bend, 0.0))
