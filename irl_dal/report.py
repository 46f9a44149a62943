"""Put any set of runs into the paper's table.

python -m irl_dal.report runs=DIR [out=DIR] [page=README.md]
"""

from irl_dal.cli.preflight import preflight

preflight("drive", "report", command=__name__)

from dataclasses import asdict
from pathlib import Path

import numpy as np
from omegaconf import DictConfig

from irl_dal.cli.command import new_console, run_command
from irl_dal.cli.overrides import path_argument, require_writable
from irl_dal.config import ConfigError
from irl_dal.figures.document import write_pictures
from irl_dal.figures.sweep import sweep_figures, write_sweep_page
from irl_dal.storage.atomic import write_json
from irl_dal.sweep.collection import Collection, collect
from irl_dal.sweep.paper_table import (
    Estimates,
    MarkedPage,
    estimates_of,
    notes,
    paper_table,
    printed_tables,
)
from irl_dal.sweep.remarks import remarks
from irl_dal.sweep.result import write_result


def main() -> None:
    """Entry point of the command."""
    run_command(_main, "report")


def _main(composed: DictConfig) -> None:
    runs, out, page_path = (path_argument(composed, key) for key in ("runs", "out", "page"))
    if runs is None:
        raise ConfigError("runs = None: name a folder of runs or of results")
    if isinstance(composed.seed, bool) or not isinstance(composed.seed, int) or composed.seed < 0:
        raise ConfigError(f"seed = {composed.seed!r}: must be a whole number from 0 on")
    page = None if page_path is None else MarkedPage.read(page_path)
    if out is not None:
        require_writable("out", out, folder=True)
    console = new_console()
    collection = collect(runs, console)
    rng = np.random.default_rng(composed.seed)
    estimates = estimates_of(collection, rng)
    for table in printed_tables(paper_table(collection, estimates)):
        console.print(table)
    for sentence in [*notes(collection), *remarks(collection, estimates)]:
        console.print(sentence, soft_wrap=True)
    if page is not None:
        page.replace(collection, estimates)
    if out is not None:
        with console.status("drawing"):
            _write(out, collection, estimates, rng)
        console.print(f"written to {out / 'index.html'}", soft_wrap=True)


def _write(
    out: Path, collection: Collection, estimates: Estimates, rng: np.random.Generator
) -> None:
    for result in collection.results:
        write_result(result, out / "results" / f"{result.name}.json")
    numbers = {
        variant: {"runs": len(collection.of(variant))}
        | {key: asdict(estimate) for key, estimate in row.items()}
        for variant, row in estimates.items()
    }
    write_json(out / "report.json", numbers)
    figures = sweep_figures(collection, estimates, rng)
    write_pictures(figures, out / "figures")
    write_sweep_page(out / "index.html", collection, estimates, figures)


if __name__ == "__main__":
    main()
