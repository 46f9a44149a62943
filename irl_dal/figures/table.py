"""Tables of numbers: how a number is written, and the table that a terminal and a page show."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text


@dataclass(frozen=True, slots=True)
class Column:
    """How a metric is printed."""

    key: str  # name in the JSON files
    title: str
    unit: str = ""  # behind the title; "%" prints a fraction times 100
    digits: int = 2  # after the point
    better: int = 0  # whether more (1) or less (-1) is better; 0 for neither
    short: str = ""  # title where there is little room, "" for the same
    paper: Mapping[str, str] = field(default_factory=dict)  # by variant, as in its Table I

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def short_heading(self) -> str:
        """Short title and unit."""
        return replace(self, title=self.short or self.title).heading

    @property
    def scale(self) -> float:
        """What a number is multiplied by."""
        return 100.0 if self.unit == "%" else 1.0

    def text(self, value: Any) -> str:
        """A value; an en dash where there is none."""
        return f"{self.scale * value:.{self.digits}f}" if isinstance(value, int | float) else "–"

    def interval(self, bounds: Sequence[float | None] | None, between: str = "–") -> str:
        """The two ends of an interval; empty without them."""
        if bounds is None or None in bounds:
            return ""
        return between.join(self.text(bound) for bound in bounds)


@dataclass(frozen=True, slots=True)
class Cell:
    """A number as it is shown."""

    text: str
    below: tuple[str, ...] = ()  # smaller numbers, one per label of the table's `below`, or ""
    hint: str = ""  # shown on a page when the pointer rests on it
    mark: str = ""  # `zero` or `hot` colours it on a page


@dataclass(frozen=True, slots=True)
class NumberTable:
    """A table for the terminal, for a page and for Markdown."""

    title: str
    headings: Sequence[str]  # of the columns behind the labels
    rows: Sequence[tuple[str, str, Sequence[Cell]]]  # label, its colour on a page or "", cells
    caption: str = ""  # below it on a page
    below: Sequence[str] = ()  # what the numbers under a cell's number are
    short: Sequence[str] = ()  # headings for the terminal, where they differ

    def printed(self, columns: Sequence[int] | None = None, title: str | None = None) -> Table:
        """For the terminal."""
        headings = self.short or self.headings
        chosen = range(len(headings)) if columns is None else columns
        rows = []
        for label, _, cells in self.rows:
            rows.append([label, *(cells[place].text for place in chosen)])
            for line, name in enumerate(self.below):
                below = [cells[place].below[line] for place in chosen]
                if any(below):
                    rows.append([f"  {name}", *below])
        title = self.title if title is None else title
        return terminal_table(title, ["", *(headings[place] for place in chosen)], rows)

    def markdown(self) -> str:
        """For Markdown: the first smaller number in brackets, the others in rows of their own."""
        lines = [["", *self.headings]]
        for label, _, cells in self.rows:
            line = [label]
            for cell in cells:
                first = next(iter(cell.below), "")
                line.append(f"{cell.text} ({first})" if first else cell.text)
            lines.append(line)
            for place, name in list(enumerate(self.below))[1:]:
                others = [cell.below[place] for cell in cells]
                if any(others):
                    lines.append([f"*{name}*", *others])
        head, *body = (f"| {' | '.join(line)} |" for line in lines)
        return "\n".join([head.replace("|  |", "| |"), "|---" * len(lines[0]) + "|", *body])


def terminal_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """A table for the terminal; the first column is left-aligned and never wrapped."""
    rows = [list(row) for row in rows]
    shown = Text(title) if title else None
    table = Table(title=shown, title_justify="left", box=SIMPLE_HEAD, padding=0, pad_edge=False)
    for place, heading in enumerate(headings):
        words = [*heading.split(), *(row[place] for row in rows)]
        widest = max(map(len, words), default=0) if place else None
        table.add_column(
            Text(heading),
            justify="right" if place else "left",
            no_wrap=not place,
            min_width=widest,
        )
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table
