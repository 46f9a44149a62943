"""The paper's Table I with ours beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from irl_dal.config import ConfigError
from irl_dal.evaluation.statistics import Estimate
from irl_dal.storage.atomic import write_text
from irl_dal.sweep.aggregate import across_runs
from irl_dal.sweep.collection import Collection

__all__ = [
    "COLUMNS",
    "Column",
    "Numbers",
    "label",
    "markdown_table",
    "numbers",
    "printed_tables",
    "put_into",
]

Numbers = Mapping[str, Mapping[str, Estimate]]
"""Estimates by variant and metric."""

LABELS = {
    "ppo_uniform": "PPO, uniform replay",
    "fsm_replay": "+ FSM replay",
    "diffusion": "+ diffusion planner",
    "irl_dal": "+ LAM + SAEC",
    "shielded": "+ projection, shield",
    "paper": "all as printed",
}
"""Words for the variants."""


@dataclass(frozen=True, slots=True)
class Column:
    """A metric in the table.

    Attributes:
        key: In an evaluation's report.
        title: Heading.
        digits: After the point.
        scale: The number is multiplied by it.
        paper: What the paper's Table I prints for each variant.
    """

    key: str
    title: str
    digits: int
    scale: float
    paper: Mapping[str, str]

    def number(self, value: float | None) -> str:
        """As it is printed; a dash for None."""
        return "–" if value is None else f"{self.scale * value:.{self.digits}f}"

    def interval(self, estimate: Estimate) -> str:
        """As `low–high`; empty without one."""
        if estimate.low is None or estimate.high is None:
            return ""
        return f"{self.number(estimate.low)}–{self.number(estimate.high)}"


def label(variant: str) -> str:
    """Words for a variant; an unknown one is shown by its name."""
    return LABELS.get(variant, variant)


def _printed(*values: str) -> dict[str, str]:
    """Table I's numbers of its four variants."""
    return dict(zip(("ppo_uniform", "fsm_replay", "diffusion", "irl_dal"), values, strict=True))


COLUMNS = (
    Column("success", "success [%]", 1, 100.0, _printed("78.1", "88.4", "92.0", "96.3")),
    Column(
        "collisions_per_1k_steps",
        "crashes / 1k",
        3,
        1.0,
        _printed("0.63", "0.30", "0.15", "0.05"),
    ),
    Column("command_violation_rate", "out of bounds [%]", 2, 100.0, {}),
    Column(
        "normalized_return", "return [0, 200]", 1, 1.0, _printed("85.2", "120.4", "155.1", "180.7")
    ),
    Column("bc_loss", "BC loss", 4, 1.0, _printed("0.171", "0.123", "0.130", "0.074")),
    Column(
        "action_similarity", "similarity [%]", 1, 100.0, _printed("65.3", "75.1", "80.2", "85.7")
    ),
    Column("ade_m", "ADE [m]", 2, 1.0, _printed("5.25", "4.10", "3.15", "2.45")),
    Column("fde_m", "FDE [m]", 2, 1.0, _printed("11.8", "9.5", "7.2", "5.1")),
)

_BEGIN, _END = "<!-- table: begin -->", "<!-- table: end -->"


def numbers(collection: Collection, rng: np.random.Generator) -> Numbers:
    """Interquartile means of all columns of all variants."""
    return {
        variant: {
            column.key: across_runs(collection.of(variant), column.key, rng) for column in COLUMNS
        }
        for variant in collection.variants
    }


def printed_tables(collection: Collection, found: Numbers) -> list[Table]:
    """What the command prints: safety first, then how near to the expert."""
    half = len(COLUMNS) // 2
    return [
        _part(collection, found, COLUMNS[:half], _title(collection)),
        _part(collection, found, COLUMNS[half:], None),
    ]


def _part(
    collection: Collection, found: Numbers, columns: Sequence[Column], title: str | None
) -> Table:
    rows = [
        row for variant in collection.variants for row in _rows(collection, variant, found, columns)
    ]
    table = Table(
        title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    table.add_column("", no_wrap=True)
    table.add_column("runs", justify="right")
    for place, column in enumerate(columns):
        widest = max(len(cells[place]) for _, _, cells in rows)
        table.add_column(Text(column.title), justify="right", min_width=widest)
    for words, runs, cells in rows:
        table.add_row(words, runs, *cells)
    return table


def _rows(
    collection: Collection, variant: str, found: Numbers, columns: Sequence[Column]
) -> Iterator[tuple[str, str, list[str]]]:
    """The variant's numbers, their intervals and the paper's numbers, where there are any."""
    estimates = [(column, found[variant][column.key]) for column in columns]
    runs = str(len(collection.of(variant)))
    yield label(variant), runs, [column.number(one.value) for column, one in estimates]
    intervals = [column.interval(one) for column, one in estimates]
    if any(intervals):
        yield "  95 %", "", intervals
    if variant in COLUMNS[0].paper:
        yield "  paper", "10", [column.paper.get(variant, "") for column in columns]


def markdown_table(collection: Collection, found: Numbers) -> str:
    """The same for a page of Markdown."""
    lines = [
        "| | runs | " + " | ".join(column.title for column in COLUMNS) + " |",
        "|---|" + "---|" * (len(COLUMNS) + 1),
    ]
    for variant in collection.variants:
        cells = []
        for column in COLUMNS:
            one = found[variant][column.key]
            interval = column.interval(one)
            cells.append(column.number(one.value) + (f" ({interval})" if interval else ""))
        runs = len(collection.of(variant))
        lines.append(f"| {label(variant)} | {runs} | " + " | ".join(cells) + " |")
        if variant in COLUMNS[0].paper:
            theirs = " | ".join(column.paper.get(variant, "") for column in COLUMNS)
            lines.append(f"| *paper* | 10 | {theirs} |")
    return "\n".join([f"{_title(collection)}.", "", *lines])


def put_into(page: Path, table: str) -> None:
    """Replace what stands between a page's two markers.

    Raises:
        ConfigError: The page is missing or has no markers.
    """
    where = f"page = {str(page)!r}"
    try:
        text = page.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{where}: there is no such file") from None
    before, begin, rest = text.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not begin or not end:
        raise ConfigError(f"{where}: lacks {_BEGIN} and {_END}")
    write_text(page, f"{before}{begin}\n\n{table}\n\n{end}{after}")


def _title(collection: Collection) -> str:
    first = collection.results[0]
    return (
        f"Interquartile mean over runs and 95 % stratified bootstrap interval; each run on "
        f"{len(first.outcomes)} episodes from seed {first.first_seed}"
    )
