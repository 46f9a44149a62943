"""The page of a report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from irl_dal.figures import FigureWithCaption, render
from irl_dal.figures.style import VARIANT_COLOURS
from irl_dal.storage.atomic import write_text
from irl_dal.sweep.collection import Collection
from irl_dal.sweep.findings import findings
from irl_dal.sweep.table import COLUMNS, Numbers, label

__all__ = ["write_page"]


def write_page(
    path: Path, collection: Collection, found: Numbers, figures: Sequence[FigureWithCaption]
) -> None:
    """Fill the template.

    Args:
        path: Where it goes, in one step.
        collection: The runs.
        found: Their estimates.
        figures: In their order.
    """
    page = render(
        "report.html.j2",
        figures,
        collection=collection,
        findings=findings(collection, found),
        found=found,
        columns=COLUMNS,
        label=label,
        colours=VARIANT_COLOURS,
    )
    write_text(path, page)
