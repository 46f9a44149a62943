"""Roads from a file: the TUM centre-line format `x_m, y_m, w_tr_right_m, w_tr_left_m`.

The file's right-hand edge is the road's right-hand edge. The ego's two lanes of 3.5 m lie along it,
so that the yellow line runs 7 m to its left; what is left of the file's width is the other
direction's. A road narrower than the two lanes is widened to the left. In hairpins to the right the
lanes swing out to the left, because no car could follow the inner edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from irl_dal.envs.road import HALF_WIDTH, LEAD_IN, LEAD_OUT, SPACING, Road

Array = NDArray[np.float64]

COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")

SHOULDER = 0.3
"""Least width beyond the yellow line [m]."""

MIN_WIDTH = 4.0
"""Of both sides together [m]; below it a file is not believed."""

MIN_LEFT_RADIUS, MIN_RADIUS = 5.0, 8.0
"""Of the yellow line after smoothing in bends to the left, where the own lanes are wider, and to
the right [m], where the edge is 7 m nearer to their centre."""

MIN_RIGHT_RADIUS = 16.0
"""Of the yellow line in bends to the right [m], whose home lane is 5.25 m nearer to their centre:
where the file's line is tighter, the lanes swing to the left as far as it is wide."""

PUSH_LENGTH = 10.0
"""Standard deviation of such a move along the road [m]."""

_PUSHES = 60

SMOOTHING = 4.0
"""Standard deviation of the Gaussian that takes the surveying noise out of the line [m]."""

GAP = 1.8
"""A file whose ends are further apart than so many usual steps is an open road."""


class TrackError(ValueError):
    """A file is not a road; the message is one line naming file, line and value."""


@dataclass(frozen=True, slots=True)
class Track:
    """The whole road of a file, every 0.5 m.

    Attributes:
        name: Of the file.
        points: Yellow centre line (n, 2) [m].
        heading: Its direction (n,) [rad], without jumps.
        curvature: Its curvature (n,) [1/m].
        left_edge: Distance from it to the left-hand edge (n,) [m].
        closed: Whether the last point leads to the first.
    """

    name: str
    points: Array
    heading: Array
    curvature: Array
    left_edge: Array
    closed: bool

    @property
    def length(self) -> float:
        """Length of the yellow line [m]."""
        return SPACING * (len(self.points) - (0 if self.closed else 1))

    @classmethod
    def read(cls, path: str | Path) -> Track:
        """Read a file.

        Raises:
            TrackError: It cannot be read, or what it describes is not a road.
        """
        path = Path(path)
        rows, lines = _rows(path)
        step = np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1)
        ends = float(np.linalg.norm(rows[0, :2] - rows[-1, :2]))
        if len(rows) > 3 and ends < 1e-6:
            rows, lines, step = rows[:-1], lines[:-1], step[:-1]
            ends = float(np.linalg.norm(rows[0, :2] - rows[-1, :2]))
        for i in np.flatnonzero(step < 1e-6)[:1]:
            raise TrackError(
                f"{path}, line {lines[i + 1]}: the point {_point(rows[i])} repeats the one before"
            )
        closed = ends <= GAP * float(np.median(step))
        points, left = _yellow_line(rows, closed)
        return cls._sample(path, points, left, closed, lines)

    @classmethod
    def _sample(
        cls, path: Path, points: Array, left: Array, closed: bool, lines: list[int]
    ) -> Track:
        """Resample the yellow line every 0.5 m and check its bends."""
        along = _arc_length(points, closed)
        count = max(4, round(along[-1] / SPACING))
        at = np.linspace(0.0, along[-1], count, endpoint=False)
        if not closed:
            at = np.arange(0.0, along[-1], SPACING)
        values = np.concatenate([points, left[:, None]], axis=1)
        if closed:
            values = np.concatenate([values, values[:1]])
        spline = CubicSpline(along, values, bc_type="periodic" if closed else "natural")
        x, first, second = spline(at), spline(at, 1), spline(at, 2)
        speed = np.hypot(first[:, 0], first[:, 1])
        curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
        heading = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
        least = np.where(curvature > 0.0, MIN_LEFT_RADIUS, MIN_RADIUS)
        sharpest = int(np.argmax(np.abs(curvature) * least))
        if abs(curvature[sharpest]) * least[sharpest] > 1.0:
            line = lines[min(len(lines) - 1, int(sharpest / len(at) * len(lines)))]
            raise TrackError(
                f"{path}, near line {line}: the centre line bends with a radius of "
                f"{1.0 / abs(curvature[sharpest]):.1f} m; at least {least[sharpest]:g} m are needed"
            )
        left_edge = np.minimum(x[:, 2], 0.8 / np.maximum(curvature, 1e-9))
        return cls(path.name, x[:, :2], heading, curvature, left_edge, closed)

    def stretches(self, length: float) -> int:
        """How many goals `length` metres apart the road has; 0 where it is too short."""
        room = self.length if self.closed else self.length - LEAD_IN - LEAD_OUT
        return int(room // length) if room >= length else 0

    def stretch(self, number: int, length: float) -> Road:
        """The road to the goal of one stretch.

        Args:
            number: Which one; counted on after the last.
            length: From one goal to the next [m].

        Raises:
            TrackError: The road is shorter than one stretch.
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
        return Road(
            self.points[place],
            heading,
            self.curvature[place],
            length,
            self.left_edge[place],
        )


def _rows(path: Path) -> tuple[Array, list[int]]:
    """The numbers (n, 4) of a file and the line that each row stands in."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not a text file"
        raise TrackError(f"{path}: {reason}") from None
    rows: list[list[float]] = []
    lines: list[int] = []
    order = list(range(4))
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.strip()
        if not content:
            continue
        if content.startswith("#") or not (rows or _is_number(content.split(",")[0])):
            order = _header(path, number, content, order)
            continue
        rows.append(_row(path, number, content, order))
        lines.append(number)
    if len(rows) < 3:
        raise TrackError(f"{path}: at least 3 points make a road, got {len(rows)}")
    return np.array(rows), lines


def _header(path: Path, number: int, content: str, order: list[int]) -> list[int]:
    """Order of the columns as a comment line names them; any other comment changes nothing."""
    names = [name.strip() for name in content.lstrip("#").split(",")]
    if not set(names) & set(COLUMNS):
        return order
    for name in COLUMNS:
        if name not in names:
            raise TrackError(
                f"{path}, line {number}: the column {name} is missing, got {', '.join(names)}"
            )
    return [names.index(name) for name in COLUMNS]


def _row(path: Path, number: int, content: str, order: list[int]) -> list[float]:
    cells = [cell.strip() for cell in content.split(",")]
    if len(cells) <= max(order):
        raise TrackError(
            f"{path}, line {number}: {max(order) + 1} columns are needed, "
            f"got {len(cells)}: {content!r}"
        )
    values = []
    for name, place in zip(COLUMNS, order, strict=True):
        cell = cells[place]
        if not _is_number(cell) or not math.isfinite(float(cell)):
            raise TrackError(f"{path}, line {number}: {name} is not a finite number, got {cell!r}")
        values.append(float(cell))
    for name, value in zip(COLUMNS[2:], values[2:], strict=True):
        if value < 0.0:
            raise TrackError(f"{path}, line {number}: {name} is negative, got {value:g}")
    if values[2] + values[3] < MIN_WIDTH:
        raise TrackError(
            f"{path}, line {number}: the road is {values[2] + values[3]:g} m wide, at least "
            f"{MIN_WIDTH:g} m are needed"
        )
    return values


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _point(row: Array) -> str:
    return f"({row[0]:g}, {row[1]:g})"


def _arc_length(points: Array, closed: bool) -> Array:
    """Arc length (n,) of each point, (n + 1,) with the way back to the first of a closed line."""
    way = np.concatenate([points, points[:1]]) if closed else points
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])


def _yellow_line(rows: Array, closed: bool) -> tuple[Array, Array]:
    """The smoothed yellow line (m, 2) every metre and the width to its left (m,)."""
    along = _arc_length(rows[:, :2], closed)
    values = np.concatenate([rows, rows[:1]]) if closed else rows
    spline = CubicSpline(along, values[:, :2], bc_type="periodic" if closed else "natural")
    at = np.linspace(0.0, along[-1], max(4, round(along[-1])), endpoint=not closed)
    mode: Literal["wrap", "nearest"] = "wrap" if closed else "nearest"
    width = np.stack([np.interp(at, along, values[:, k]) for k in (2, 3)], axis=1)
    width = gaussian_filter1d(width, 2.0 * SMOOTHING, axis=0, mode=mode)
    tangent = spline(at, 1)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    centre = spline(at)
    if closed:
        centre = gaussian_filter1d(centre, SMOOTHING, axis=0, mode="wrap")
    offset = HALF_WIDTH - width[:, 0]
    for _ in range(_PUSHES):
        line = centre + offset[:, None] * normal
        tight = _right_bend(line) * MIN_RIGHT_RADIUS > 1.0
        if not tight.any():
            break
        push = gaussian_filter1d(tight.astype(float), PUSH_LENGTH, mode=mode)
        limit = np.maximum(offset, width[:, 1] - SHOULDER)
        offset = np.minimum(offset + 0.5 * push / max(float(push.max()), 1e-9), limit)
        offset = gaussian_filter1d(offset, SMOOTHING, mode=mode)
    left = np.maximum(width[:, 1] - offset, SHOULDER)
    return line, left


def _right_bend(line: Array) -> Array:
    """Curvature to the right (m,) [1/m] of points a metre apart, 0 at both ends."""
    first = np.gradient(line, axis=0)
    second = np.gradient(first, axis=0)
    turn = first[:, 1] * second[:, 0] - first[:, 0] * second[:, 1]
    bend = turn / np.maximum(np.einsum("ij,ij->i", first, first), 1e-12) ** 1.5
    bend[:2] = bend[-2:] = 0.0
    return np.asarray(np.maximum(bend, 0.0))
