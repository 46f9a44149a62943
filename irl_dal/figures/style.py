"""How figures look: the palette of all of them, and the frame of those on pages."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[np.float64]

GREY = "#8a9099"
"""Lines and ticks: readable on white and on black."""

PALETTE = {
    "ground": "#dfe6d8",
    "road": "#8f959c",
    "edge": "#ffffff",
    "centre": "#f2b705",
    "obstacle": "#33404f",
    "barrel": "#d8611a",
    "ego": "#1f77b4",  # of curves; the car itself is red as in the chase view
    "plan": "#d81b60",
    "car": "#b71c1c",
    "lidar": "#00838f",
    "trail": "#0b3c5d",
    "muted": "#9aa0a6",
    "text": "#5f6368",
    "violation": "#d50000",
}
"""Colours by what is drawn."""

MODE_COLOURS = {
    "none": "#e573a5",
    "final": "#f2a007",
    "x0": "#1f77d0",
    "xt": "#7e57c2",
    "adaptive": "#00897b",
}
"""Colours of the projection modes."""

VARIANT_COLOURS = {
    "ppo_uniform": "#d64545",
    "fsm_replay": "#e8890c",
    "diffusion": "#c2a400",
    "irl_dal": "#2e9e5b",
    "shielded": "#1f77d0",
    "paper": "#8c6bb1",
}
"""Colours of the variants, as in the paper's figures, where it has them."""

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


@contextmanager
def drawing(width: float, height: float) -> Iterator[Figure]:
    """An empty figure [in] in the page's look."""
    with rc_context(_LOOK):
        yield Figure(figsize=(width, height), layout="constrained")


def to_svg(figure: Figure, name: str) -> str:
    """A figure as an SVG element; `name` keeps its identifiers apart from other figures'."""
    buffer = io.StringIO()
    with rc_context({**_LOOK, "svg.hashsalt": name}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def picture(figure: Figure, path: str) -> None:
    """Write a figure as a PNG file on white."""
    figure.savefig(path, dpi=130, facecolor="white")
