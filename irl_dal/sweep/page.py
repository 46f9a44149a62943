"""The page of a report: one file, no network, every figure in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from irl_dal.comparison.style import to_svg
from irl_dal.sweep.collection import Collection
from irl_dal.sweep.figures import VARIANT_COLOURS
from irl_dal.sweep.findings import findings
from irl_dal.sweep.table import COLUMNS, LABELS, Numbers

__all__ = ["Shown", "write_page"]


@dataclass(frozen=True, slots=True)
class Shown:
    """A figure with its words."""

    name: str
    figure: Figure
    title: str
    caption: str

    @property
    def svg(self) -> Markup:
        """For the page; matplotlib's own drawing, nothing of a user's."""
        return Markup(to_svg(self.figure, self.name))


def write_page(
    path: Path, collection: Collection, found: Numbers, figures: Sequence[Shown]
) -> None:
    """Fill the template.

    Args:
        path: Where it goes, in one step.
        collection: The runs.
        found: Their estimates.
        figures: In their order.
    """
    environment = Environment(
        loader=PackageLoader("irl_dal.sweep"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("report.html.j2").render(
        collection=collection,
        findings=findings(collection, found),
        found=found,
        columns=COLUMNS,
        labels=LABELS,
        colours=VARIANT_COLOURS,
        figures=figures,
    )
    partial = path.with_name(f".{path.name}.part")
    partial.write_text(page, encoding="utf-8")
    partial.replace(path)
