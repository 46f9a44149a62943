"""Centre lines in the TUM format: `x_m, y_m, w_tr_right_m, w_tr_left_m`, one point a line.

Numbers are separated by commas, semicolons, tabs or spaces. A heading, with or without `#`, orders
the columns by name; without one the four columns have the order above. Nothing is guessed: a line
that is neither heading, comment nor point refuses the file.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from irl_dal.arrays import Array

COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")
# Of both sides together [m]: narrower than a lane, wider than a runway
MIN_WIDTH, MAX_WIDTH = 4.0, 100.0
MAX_STEP = 5_000.0  # Between two points [m]; a longer one is a slip of the pen, not a straight
# Points are moved by multiples of this [m], the first one to half of it from the origin at most:
# the renderer has single precision, in which map coordinates of 5,000 km have steps of 0.5 m
GRID = 10_000.0
REPEATED = 1e-6  # Points closer than this are the same [m]
CLOSING = 0.1  # A last point this near to the first repeats it, rounded [m]
OVERLAP = 1.0  # A line that passes its own first point within this distance begins a second lap [m]
USUAL_GAP = 1.8  # Ends no further apart than so many median steps close the line
# Largest turn into and out of the gap between the ends of a closed line [rad]: where the gap is no
# longer than the longest step, and no longer than `STRAIGHT_SHARE` of the file. TUM's 24 raw
# circuits have gaps of up to 57 median steps and turns of at most 38 degrees; the one gap longer
# than the longest step, 13 % of its circuit, has turns of 1 degree.
LONGEST_TURN, STRAIGHT_TURN = math.radians(45.0), math.radians(10.0)
STRAIGHT_SHARE = 0.2


class TrackError(ValueError):
    """A file is not a road; the message is one line naming file, line and value."""


@dataclass(frozen=True, slots=True)
class TrackFile:
    """The points of a file."""

    path: Path  # Of the file
    # Centre line (n, 2) [m], moved to the origin by multiples of `GRID`; a closed line does not
    # repeat its first point
    points: Array
    widths: Array  # From it to the right and to the left edge (n, 2) [m]
    lines: tuple[int, ...]  # Line of the file that each point stands in
    closed: bool  # Whether the last point leads to the first

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file; `TrackError` if it cannot be read, or a line is no point of a road."""
        path = Path(path)
        rows, lines = _Reader(path).rows()
        while len(rows) > 3 and np.linalg.norm(rows[-1, :2] - rows[0, :2]) < CLOSING:
            rows = rows[:-1]
        _check_steps(path, rows, lines)
        rows = _one_lap(rows)
        points = rows[:, :2] - GRID * np.round(rows[0, :2] / GRID)
        return cls(path, points, rows[:, 2:], tuple(lines[: len(rows)]), _is_closed(points))

    def error(self, point: int, message: str) -> TrackError:
        """An error that names the line of a point."""
        return _error(self.path, self.lines[point], message)


class _Reader:
    """Reads the lines of one file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._order: list[int] | None = None
        self._count = len(COLUMNS)
        self._doubtful: tuple[int, list[str]] | None = None

    def rows(self) -> tuple[Array, list[int]]:
        """The numbers (n, 4), n > 2, and the line that each row stands in."""
        rows: list[list[float]] = []
        lines: list[int] = []
        for number, line in enumerate(self._text().split("\n"), start=1):
            content = line.strip()
            if not content:
                continue
            cells = _cells(content.lstrip("#"))
            if content.startswith("#"):
                self._comment(number, cells)
            elif not rows and self._order is None and not any(map(_is_number, cells)):
                self._take_heading(number, cells)
            else:
                if self._order is None and self._doubtful is not None:
                    self._take_heading(*self._doubtful)
                rows.append(self._row(number, cells))
                lines.append(number)
        if len(rows) < 3:
            raise TrackError(f"{self._path}: at least 3 points make a road, got {len(rows)}")
        return np.array(rows), lines

    def _text(self) -> str:
        try:
            return self._path.read_text(encoding="utf-8-sig")
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or "is not a text file"
            raise TrackError(f"{self._path}: {reason}") from None

    def _comment(self, number: int, cells: list[str]) -> None:
        """Take a comment that names columns for a heading; keep one that may name others."""
        if len(set(cells) & set(COLUMNS)) > 1:
            self._take_heading(number, cells)
        elif len(cells) >= len(COLUMNS) and all(map(str.isidentifier, cells)):
            self._doubtful = (number, cells)

    def _take_heading(self, number: int, names: Sequence[str]) -> None:
        got = f"got {', '.join(names)}"
        missing = [name for name in COLUMNS if name not in names]
        if missing:
            what = "column {} is" if len(missing) == 1 else "columns {} are"
            raise _error(
                self._path, number, f"the {what.format(', '.join(missing))} missing, {got}"
            )
        for name in COLUMNS:
            if names.count(name) > 1:
                raise _error(self._path, number, f"the column {name} is named twice, {got}")
        order = [names.index(name) for name in COLUMNS]
        if self._order not in (None, order):
            raise _error(self._path, number, f"a second heading orders the columns anew, {got}")
        self._order, self._count = order, len(names)

    def _row(self, number: int, cells: Sequence[str]) -> list[float]:
        if len(cells) != self._count:
            got = f"got {len(cells)}: {', '.join(cells)!r}"
            raise _error(self._path, number, f"{self._count} columns are needed, {got}")
        values = []
        for name, place in zip(COLUMNS, self._order or range(len(COLUMNS)), strict=True):
            cell = cells[place]
            if not _is_number(cell) or not math.isfinite(float(cell)):
                raise _error(self._path, number, f"{name} is not a finite number, got {cell!r}")
            values.append(float(cell))
        for name, value in zip(COLUMNS[2:], values[2:], strict=True):
            if value < 0.0:
                raise _error(self._path, number, f"{name} is negative, got {value:g}")
        width = values[2] + values[3]
        if not MIN_WIDTH <= width <= MAX_WIDTH:
            need = f"at least {MIN_WIDTH:g}" if width < MIN_WIDTH else f"at most {MAX_WIDTH:g}"
            raise _error(self._path, number, f"the road is {width:g} m wide, {need} m are possible")
        return values


def _error(path: Path, line: int, message: str) -> TrackError:
    return TrackError(f"{path}, line {line}: {message}")


def _cells(content: str) -> list[str]:
    """The cells of a line; a separator at its end opens no further one."""
    separator = next((mark for mark in ";," if mark in content), None)
    cells = [cell.strip() for cell in content.strip().split(separator)]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _is_number(cell: str) -> bool:
    """Whether a cell is a number, NaN and infinity included."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _check_steps(path: Path, rows: Array, lines: Sequence[int]) -> None:
    """Refuse points that repeat the one before or lie too far from it."""
    step = np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1)
    for i in np.flatnonzero(step < REPEATED)[:1]:
        point = f"({rows[i, 0]:g}, {rows[i, 1]:g})"
        raise _error(path, lines[i + 1], f"the point {point} repeats the one before")
    for i in np.flatnonzero(step > MAX_STEP)[:1]:
        far = f"the point is {step[i]:g} m from the one before, at most {MAX_STEP:g} m are possible"
        raise _error(path, lines[i + 1], far)


def _one_lap(rows: Array) -> Array:
    """The rows without those at the end that drive over the first ones again."""
    start = rows[0, :2]
    step = np.diff(rows[:, :2], axis=0)
    length = np.linalg.norm(step, axis=1)
    to_start = start - rows[:-1, :2]
    share = np.einsum("ij,ij->i", to_start, step) / length**2
    aside = np.linalg.norm(to_start - share[:, None] * step, axis=1)
    along = step @ step[0] > math.cos(LONGEST_TURN) * length * length[0]
    passes = (share >= 0.0) & (share <= 1.0) & (aside < OVERLAP) & along
    passes[: len(passes) // 2] = False
    return rows[: int(np.flatnonzero(passes)[0]) + 1] if passes.any() else rows


def _is_closed(points: Array) -> bool:
    """Whether the way from the last point (of n, 2) to the first is a part of the road."""
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    gap = points[0] - points[-1]
    ends = float(np.linalg.norm(gap))
    if ends <= USUAL_GAP * float(np.median(length)):
        return True
    turn = max(_angle(step[-1], gap), _angle(gap, step[0]))
    straight = turn <= STRAIGHT_TURN and ends <= STRAIGHT_SHARE * float(length.sum())
    return straight or (turn <= LONGEST_TURN and ends <= float(length.max()))


def _angle(one: Array, other: Array) -> float:
    """Angle between two directions (2,) [rad]."""
    return abs(math.atan2(one[0] * other[1] - one[1] * other[0], float(one @ other)))
