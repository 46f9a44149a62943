"""Put any set of runs into the paper's table.

python -m irl_dal.report runs=DIR [out=DIR] [page=README.md]
"""

from __future__ import annotations

from irl_dal.cli.preflight import preflight

preflight("drive", "report")

from dataclasses import asdict
from pathlib import Path

import numpy as np
from omegaconf import DictConfig

from irl_dal.cli.command import new_console, run_command
from irl_dal.cli.overrides import path_argument, require_writable
from irl_dal.config import ConfigError
from irl_dal.figures import FigureWithCaption, write_pictures
from irl_dal.figures.sweep import draw_dynamics, draw_overlay, draw_scores
from irl_dal.figures.sweep_page import write_page
from irl_dal.storage.atomic import write_json
from irl_dal.sweep.collection import Collection, collect
from irl_dal.sweep.findings import findings
from irl_dal.sweep.result import write_result
from irl_dal.sweep.table import Numbers, markdown_table, numbers, printed_tables, put_into

__all__ = ["main"]


def main() -> None:
    """Entry point of the command."""
    run_command(_main, "report")


def _main(composed: DictConfig) -> None:
    runs, out, page = (path_argument(composed, key) for key in ("runs", "out", "page"))
    if runs is None:
        raise ConfigError("runs = None: name a folder of runs or of results")
    if not isinstance(composed.seed, int) or composed.seed < 0:
        raise ConfigError(f"seed = {composed.seed!r}: must be a whole number from 0 on")
    if out is not None:
        require_writable("out", out, folder=True)
    console = new_console()
    collection = collect(runs, console)
    for path in collection.unfinished:
        console.print(f"not finished, left out: {path}", soft_wrap=True)
    if not collection.results:
        raise ConfigError(f"runs = {str(runs)!r}: no run is finished")
    rng = np.random.default_rng(composed.seed)
    found = numbers(collection, rng)
    for table in printed_tables(collection, found):
        console.print(table)
    for sentence in findings(collection, found):
        console.print(sentence)
    if page is not None:
        put_into(page, markdown_table(collection, found))
    if out is not None:
        with console.status("drawing"):
            _write(out, collection, found, rng)
        console.print(f"written to {out / 'index.html'}", soft_wrap=True)


def _write(out: Path, collection: Collection, found: Numbers, rng: np.random.Generator) -> None:
    """Results, numbers, pictures and the page."""
    for result in collection.results:
        write_result(result, out / "results" / f"{result.name}.json")
    write_json(
        out / "report.json",
        {
            variant: {"runs": len(collection.of(variant))}
            | {key: asdict(one) for key, one in estimates.items()}
            for variant, estimates in found.items()
        },
    )
    figures = _figures(collection, found, rng)
    write_pictures(figures, out / "figures")
    write_page(out / "index.html", collection, found, figures)


def _figures(
    collection: Collection, found: Numbers, rng: np.random.Generator
) -> tuple[FigureWithCaption, ...]:
    return (
        FigureWithCaption(
            "scores",
            draw_scores(collection, found),
            "Every number of the table",
            "Diamonds: interquartile mean over the runs; bars: 95 % stratified bootstrap interval; "
            "dots: single runs.",
        ),
        FigureWithCaption(
            "dynamics",
            draw_dynamics(collection, collection.boundary, rng),
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
    )


if __name__ == "__main__":
    main()
