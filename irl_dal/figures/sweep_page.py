"""The page of a report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from irl_dal.figures.document import FigureWithCaption, render_page
from irl_dal.figures.style import GREY, VARIANT_COLOURS
from irl_dal.figures.sweep import draw_dynamics, draw_overlay, draw_scores
from irl_dal.figures.table import Cell, NumberTable
from irl_dal.storage.atomic import write_text
from irl_dal.sweep.collection import Collection
from irl_dal.sweep.paper_table import COLUMNS, Estimates, paper_table
from irl_dal.sweep.remarks import remarks


def sweep_figures(
    collection: Collection, estimates: Estimates, rng: np.random.Generator
) -> list[FigureWithCaption]:
    """Draw everything that a report shows."""
    return [
        FigureWithCaption(
            "scores",
            draw_scores(collection, estimates),
            "Every number of the table",
            "Diamonds: interquartile mean over the runs; bars: 95 % stratified bootstrap interval; "
            "dots: single runs.",
        ),
        FigureWithCaption(
            "dynamics",
            draw_dynamics(collection, rng),
            "Training dynamics",
            "Interquartile mean and 95 % interval over the runs, running mean of five rows. "
            "Dashed: the policy begins to drive.",
        ),
        FigureWithCaption(
            "overlay",
            draw_overlay(collection),
            "One bend, every variant",
            "The first run of each variant in the same episode; a cross where a drive ended early.",
        ),
    ]


def write_sweep_page(
    path: Path,
    collection: Collection,
    estimates: Estimates,
    figures: Sequence[FigureWithCaption],
) -> None:
    """Write tables and figures as one HTML file."""
    page = render_page(
        "The paper's table, ours beside it",
        remarks(collection, estimates),
        [paper_table(collection, estimates)],
        figures,
        [_runs(collection)],
    )
    write_text(path, page)


def _runs(collection: Collection) -> NumberTable:
    """Every run with its origin."""
    headings = ["success [%]", "training [min]", "configuration", "commit", "machine"]
    rows = []
    for run in collection.results:
        seconds = run.origin.get("training_seconds")
        cells = [
            COLUMNS[0].text(run.score("success")),
            f"{seconds / 60.0:.1f}" if isinstance(seconds, int | float) else "–",
            run.configuration,
            str(run.origin.get("commit") or "unknown")[:10],
            str(run.origin.get("machine")),
        ]
        rows.append(
            (run.name, VARIANT_COLOURS.get(run.variant, GREY), [Cell(text) for text in cells])
        )
    return NumberTable("The runs", headings, rows)
