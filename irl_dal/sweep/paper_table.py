"""The paper's Table I with ours beside it."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from rich.table import Table

from irl_dal.config import ConfigError
from irl_dal.evaluation.statistics import Estimate
from irl_dal.figures.style import GREY, VARIANT_COLOURS
from irl_dal.figures.table import Cell, Column, NumberTable
from irl_dal.storage.atomic import write_text
from irl_dal.sweep.across_runs import across_runs
from irl_dal.sweep.collection import Collection

Estimates = Mapping[str, Mapping[str, Estimate]]  # by variant and metric

LABELS = {
    "ppo_uniform": "PPO, uniform replay",
    "fsm_replay": "+ FSM replay",
    "diffusion": "+ diffusion planner",
    "irl_dal": "+ LAM + SAEC",
    "shielded": "+ projection, shield",
    "paper": "all as printed",
}
"""Words for the variants."""

PAPER_RUNS = "10"  # runs behind each number of the paper's Table I


def _printed(*values: str) -> dict[str, str]:
    """Table I's numbers of its four variants."""
    return dict(zip(("ppo_uniform", "fsm_replay", "diffusion", "irl_dal"), values, strict=True))


COLUMNS: tuple[Column, ...] = (
    Column("success", "success", "%", 1, 1, paper=_printed("78.1", "88.4", "92.0", "96.3")),
    Column(
        "collisions_per_1k_steps", "crashes / 1k", "", 3, -1,
        paper=_printed("0.63", "0.30", "0.15", "0.05"),
    ),
    Column("command_violation_rate", "out of bounds", "%", 2, -1),
    Column(
        "normalized_return", "return [0, 200]", "", 1, 1,
        paper=_printed("85.2", "120.4", "155.1", "180.7"),
    ),
    Column("bc_loss", "BC loss", "", 4, -1, paper=_printed("0.171", "0.123", "0.130", "0.074")),
    Column(
        "action_similarity", "similarity", "%", 1, 1,
        paper=_printed("65.3", "75.1", "80.2", "85.7"),
    ),
    Column("ade_m", "ADE", "m", 2, -1, paper=_printed("5.25", "4.10", "3.15", "2.45")),
    Column("fde_m", "FDE", "m", 2, -1, paper=_printed("11.8", "9.5", "7.2", "5.1")),
)  # fmt: skip

NOT_IN_SUMMARY = ("bc_loss", "action_similarity", "fde_m")


def label(variant: str) -> str:
    """Words for a variant; an unknown one is shown by its name."""
    return LABELS.get(variant, variant)


def estimates_of(collection: Collection, rng: np.random.Generator) -> Estimates:
    """Interquartile means of all columns of all variants."""
    return {
        variant: {
            column.key: across_runs(collection.of(variant), column.key, rng) for column in COLUMNS
        }
        for variant in collection.variants
    }


def paper_table(collection: Collection, estimates: Estimates) -> NumberTable:
    """The table, for whatever shows it."""
    rows = []
    for variant in collection.variants:
        theirs = PAPER_RUNS if variant in COLUMNS[0].paper else ""
        cells = [Cell(str(len(collection.of(variant))), ("", theirs))]
        for column in COLUMNS:
            one = estimates[variant][column.key]
            interval = column.interval((one.low, one.high))
            cells.append(Cell(column.text(one.value), (interval, column.paper.get(variant, ""))))
        rows.append((label(variant), VARIANT_COLOURS.get(variant, GREY), cells))
    first = collection.results[0]
    return NumberTable(
        f"Interquartile mean over runs and 95 % stratified bootstrap interval; each run on "
        f"{len(first.outcomes)} episodes from seed {first.first_seed}",
        ["runs", *(column.heading for column in COLUMNS)],
        rows,
        " ".join(notes(collection)),
        ("95 %", "paper"),
    )


def printed_tables(table: NumberTable) -> list[Table]:
    """What the command prints: safety first, then how near to the expert."""
    half, last = len(COLUMNS) // 2, len(COLUMNS)
    return [table.printed(range(half + 1)), table.printed([0, *range(half + 1, last + 1)], "")]


def markdown_table(collection: Collection, estimates: Estimates) -> str:
    """The same for a page of Markdown, with the notes below."""
    table = paper_table(collection, estimates)
    return "\n\n".join([f"{table.title}.", table.markdown(), *notes(collection)])


def markdown_summary(collection: Collection, estimates: Estimates) -> str:
    """One line a variant, some columns left out; half the interval's width behind `±`."""
    columns = [column for column in COLUMNS if column.key not in NOT_IN_SUMMARY]
    rows = []
    for variant in collection.variants:
        cells = []
        for column in columns:
            one = estimates[variant][column.key]
            half = f" ± {column.text(np.ptp(one.bounds) / 2.0)}" if one.bounds else ""
            cells.append(Cell(column.text(one.value) + half))
        rows.append((label(variant), "", cells))
    return NumberTable("", [column.heading for column in columns], rows).markdown()


def notes(collection: Collection) -> list[str]:
    """What a reader of the table has to know: runs left out, rows made by several commits."""
    mixed = []
    for variant in collection.variants:
        commits = {commit[:7] for run in collection.of(variant) for commit in run.commits}
        if len(commits) > 1:
            mixed.append(f"{label(variant)} ({', '.join(sorted(commits))})")
    several = [f"Rows whose runs are of several commits: {'; '.join(mixed)}."] if mixed else []
    return [*several, *collection.left_out]


class MarkedPage(NamedTuple):
    """A Markdown page with a table between `<!-- KIND: begin -->` and `<!-- KIND: end -->`."""

    path: Path
    kind: str  # `table` for the whole table, `summary` for the short one
    before: str  # text up to and with the first marker
    after: str  # text from the second marker on

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a page; a ConfigError if it is missing, cannot be read or lacks the markers."""
        where = f"page = {str(path)!r}"
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{where}: {error.strerror}") from None
        except UnicodeDecodeError:
            raise ConfigError(f"{where}: is not UTF-8 text") from None
        for kind in ("table", "summary"):
            before, begin, rest = text.partition(f"<!-- {kind}: begin -->")
            _, end, after = rest.partition(f"<!-- {kind}: end -->")
            if begin and end:
                return cls(path, kind, before + begin, end + after)
        raise ConfigError(
            f"{where}: lacks <!-- table: begin --> and <!-- table: end -->, or the same of summary"
        )

    def replace(self, collection: Collection, estimates: Estimates) -> None:
        """Write the page with the table of other runs; a ConfigError if that fails."""
        whole = self.kind == "table"
        table = (markdown_table if whole else markdown_summary)(collection, estimates)
        try:
            write_text(self.path, f"{self.before}\n\n{table}\n\n{self.after}")
        except OSError as error:
            raise ConfigError(f"page = {str(self.path)!r}: {error.strerror}") from None
