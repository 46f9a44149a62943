"""The curves of a training: reward, behaviour cloning loss and interventions over steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter
from numpy.typing import NDArray

from irl_dal.figures.style import PALETTE
from irl_dal.learning.run_log import read_metrics

__all__ = ["draw_training"]

Array = NDArray[np.float64]

DPI = 130


@dataclass(frozen=True, slots=True)
class _Curve:
    """A line in a panel.

    Attributes:
        column: Column of the metrics file.
        label: Entry of the legend.
        colour: Key of the palette.
        style: Line style.
    """

    column: str
    label: str
    colour: str
    style: str = "-"


@dataclass(frozen=True, slots=True)
class _Panel:
    """One figure.

    Attributes:
        name: File name without its ending.
        title: What it shows.
        unit: Label of the vertical axis.
        curves: Its lines.
        logarithmic: Vertical axis.
        percent: Fractions shown as percent.
    """

    name: str
    title: str
    unit: str
    curves: Sequence[_Curve]
    logarithmic: bool = False
    percent: bool = False


_PANELS = (
    _Panel(
        "reward",
        "Environment reward per episode",
        "return, last 20 episodes",
        (_Curve("rollout/episode_return", "episode return", "ego"),),
    ),
    _Panel(
        "bc_loss",
        "Behaviour cloning loss",
        "mean squared error",
        (
            _Curve("bc/train_loss", "training batches", "muted"),
            _Curve("bc/loss", "held-out episodes, modes balanced", "ego"),
        ),
        logarithmic=True,
    ),
    _Panel(
        "interventions",
        "Interventions",
        "share of steps",
        (
            _Curve("rollout/shield_rate", "command changed by the shield", "muted"),
            _Curve("rollout/intervention_rate", "planner triggered", "plan"),
        ),
        percent=True,
    ),
)


def draw_training(metrics: Path, folder: Path, boundary: int) -> list[Path]:
    """Draw every panel on its own and all of them in one picture.

    Args:
        metrics: A run's `metrics.csv`.
        folder: Where the PNG files go.
        boundary: Step at which the second phase begins.

    Returns:
        The files written.
    """
    rows = read_metrics(metrics)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for panel in _PANELS:
        figure = _figure(6.4, 3.6)
        _draw(figure.add_subplot(), panel, rows, boundary)
        written.append(_save(figure, folder / f"{panel.name}.png"))
    figure = _figure(6.4, 8.4)
    axes = figure.subplots(len(_PANELS), 1, sharex=True)
    for one, panel in zip(axes, _PANELS, strict=True):
        _draw(one, panel, rows, boundary)
    for one in axes[:-1]:
        one.set_xlabel("")
    return [*written, _save(figure, folder / "training.png")]


def _draw(axes: Axes, panel: _Panel, rows: Sequence[Mapping[str, str]], boundary: int) -> None:
    positive = False
    for curve in panel.curves:
        steps, values = _column(rows, curve.column)
        positive |= bool((values > 0.0).any())
        axes.plot(
            steps,
            values,
            curve.style,
            color=PALETTE[curve.colour],
            label=curve.label,
            linewidth=1.8,
            marker="o" if len(steps) < 3 else None,
        )
    axes.set_title(panel.title, loc="left", fontsize=11, pad=16)
    axes.set_xlim(left=0.0, right=float(rows[-1]["step"]) if rows else None)
    axes.set(xlabel="environment step", ylabel=panel.unit)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if panel.logarithmic and positive:
        axes.set_yscale("log")
    if panel.percent:
        axes.set_ylim(bottom=0.0)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    axes.grid(alpha=0.3, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    _mark_phases(axes, boundary)
    if len(panel.curves) > 1:
        axes.legend(frameon=False, fontsize=8)


def _mark_phases(axes: Axes, boundary: int) -> None:
    """A line between the phases and their names beside it, above the curves."""
    axes.axvline(boundary, color="black", linewidth=1.0, linestyle="--")
    place = axes.get_xaxis_transform()
    for name, side, shift in (("imitation", "right", -4), ("mixed", "left", 4)):
        axes.annotate(
            name,
            (boundary, 1.0),
            xycoords=place,
            xytext=(shift, 3),
            textcoords="offset points",
            ha=side,
            fontsize=8,
            color=PALETTE["text"],
        )


def _column(rows: Sequence[Mapping[str, str]], name: str) -> tuple[Array, Array]:
    """Steps and values of the rows that have a finite value in a column."""
    pairs = [(float(row["step"]), float(row[name])) for row in rows if row.get(name)]
    table = np.array(pairs, np.float64).reshape(-1, 2)
    table = table[np.isfinite(table[:, 1])]
    return table[:, 0], table[:, 1]


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path)
    return path
