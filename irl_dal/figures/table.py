"""Tables of numbers: how a number is written, and the table that a terminal and a page show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text


@dataclass(frozen=True, slots=True)
class Column:
    """How a metric is printed.

    Attributes:
        key: Name of the metric in the JSON files.
        title: Above the column.
        unit: Behind the title; "%" prints a fraction times 100.
        digits: After the point.
        better: Whether more (1) or less (-1) is better; 0 for neither.
        short: Title where there is little room, "" for the same.
        paper: What the paper's Table I prints for each variant.
    """

    key: str
    title: str
    unit: str = ""
    digits: int = 2
    better: int = 0
    short: str = ""
    paper: Mapping[str, str] = field(default_factory=dict)

    @property
    def heading(self) -> str:
        """Title and unit."""
        return self._with_unit(self.title)

    @property
    def short_heading(self) -> str:
        """Short title and unit."""
        return self._with_unit(self.short or self.title)

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

    def _with_unit(self, title: str) -> str:
        return f"{title} [{self.unit}]" if self.unit else title


@dataclass(frozen=True, slots=True)
class Cell:
    """A number as it is shown.

    Attributes:
        text: The number.
        below: Smaller numbers under it, one per label in the table's `below`; "" for none.
        hint: Shown on a page when the pointer rests on it.
        mark: `zero` or `hot` colours it on a page, "" does not.
    """

    text: str
    below: tuple[str, ...] = ()
    hint: str = ""
    mark: str = ""


@dataclass(frozen=True, slots=True)
class NumberTable:
    """A table for the terminal, for a page and for Markdown.

    Attributes:
        title: Above it.
        headings: Of the columns behind the labels.
        rows: Label, its colour on a page ("" for none) and cells.
        caption: Below it on a page.
        below: What the numbers under a cell's number are.
        short: Headings for the terminal, where they differ.
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[tuple[str, str, Sequence[Cell]]]
    caption: str = ""
    below: Sequence[str] = ()
    short: Sequence[str] = ()

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
        lines = [["", *self.headings], ["---"] * (len(self.headings) + 1)]
        for label, _, cells in self.rows:
            first = [next(iter(cell.below), "") for cell in cells]
            numbers = [
                f"{cell.text} ({below})" if below else cell.text
                for cell, below in zip(cells, first, strict=True)
            ]
            lines.append([label, *numbers])
            for line, name in list(enumerate(self.below))[1:]:
                others = [cell.below[line] for cell in cells]
                if any(others):
                    lines.append([f"*{name}*", *others])
        head, rule, *body = lines
        return "\n".join(
            [f"| {' | '.join(head)} |".replace("|  |", "| |"), f"|{'|'.join(rule)}|"]
            + [f"| {' | '.join(line)} |" for line in body]
        )


def terminal_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """A table for the terminal; the first column is left-aligned and never wrapped."""
    rows = [list(row) for row in rows]
    table = Table(
        title=Text(title) if title else None, title_justify="left", box=SIMPLE_HEAD, padding=0,
        pad_edge=False,
    )  # fmt: skip
    for place, heading in enumerate(headings):
        widest = max(map(len, [*heading.split(), *(row[place] for row in rows)]), default=0)
        if place == 0:
            table.add_column(Text(heading), no_wrap=True)
        else:
            table.add_column(Text(heading), justify="right", min_width=widest)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table
