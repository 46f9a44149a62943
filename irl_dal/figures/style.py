"""How the figures of pages look: vector drawings whose words the page colours."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

__all__ = ["GREY", "PNG", "drawing", "picture", "to_svg"]

GREY = "#8a9099"
"""Of lines and ticks: readable on white and on black."""

_LOOK: dict[Any, Any] = {
    "font.family": ["sans-serif"],
    "font.size": 10.0,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GREY,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": "black",
    "ytick.labelcolor": "black",
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "svg.fonttype": "none",
}

PNG = 130
"""Resolution of pictures [dots per inch]."""


@contextmanager
def drawing(width: float, height: float) -> Iterator[Figure]:
    """An empty figure [in] in the page's look."""
    with rc_context(_LOOK):
        yield Figure(figsize=(width, height), layout="constrained")


def to_svg(figure: Figure, name: str) -> str:
    """A figure as an SVG element.

    Args:
        figure: Drawn with `drawing`.
        name: Keeps its identifiers apart from those of other figures of the page.
    """
    buffer = io.StringIO()
    with rc_context({**_LOOK, "svg.hashsalt": name}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def picture(figure: Figure, path: str) -> None:
    """Write a figure as a PNG file on white."""
    figure.savefig(path, dpi=PNG, facecolor="white")
