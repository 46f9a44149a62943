"""The curves of a training: reward, behaviour cloning loss and interventions over steps."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter, PercentFormatter

from irl_dal.figures.style import GREY, PALETTE, drawing, picture
from irl_dal.learning.run_log import read_metrics

# Name: title, unit, and lines as column: (legend, key of the palette)
_PANELS: dict[str, tuple[str, str, dict[str, tuple[str, str]]]] = {
    "reward": (
        "Environment reward per episode",
        "return, last 20 episodes",
        {"rollout/episode_return": ("episode return", "ego")},
    ),
    "bc_loss": (
        "Behaviour cloning loss",
        "mean squared error",
        {
            "bc/train_loss": ("training batches", "muted"),
            "bc/loss": ("held-out episodes, modes balanced", "ego"),
        },
    ),
    "interventions": (
        "Interventions",
        "share of steps",
        {
            "rollout/shield_rate": ("command changed by the shield", "muted"),
            "rollout/intervention_rate": ("planner triggered", "plan"),
        },
    ),
}


def draw_training(metrics: Path, folder: Path, boundary: int) -> list[Path]:
    """Draw every panel of a run's `metrics.csv` on its own and all of them in one picture.

    The second phase begins at the step `boundary`. Returns the PNG files written into `folder`.
    """
    rows = read_metrics(metrics)
    folder.mkdir(parents=True, exist_ok=True)
    groups = {name: [name] for name in _PANELS} | {"training": list(_PANELS)}
    for name, panels in groups.items():
        with drawing(6.4, 0.8 + 2.7 * len(panels)) as figure:
            axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
            for place, panel in zip(axes, panels, strict=True):
                _draw(place, panel, rows, boundary)
            axes[-1].set_xlabel("environment step")
            picture(figure, str(folder / f"{name}.png"))
    return [folder / f"{name}.png" for name in groups]


def _draw(axes: Axes, panel: str, rows: Sequence[Mapping[str, str]], boundary: int) -> None:
    title, unit, curves = _PANELS[panel]
    highest = 0.0
    for column, (label, colour) in curves.items():
        known = [(row["step"], row[column]) for row in rows if row.get(column)]
        table = np.array(known, np.float64).reshape(-1, 2)
        steps, values = table[np.isfinite(table[:, 1])].T
        highest = max([highest, *values])
        marker = "o" if len(steps) < 3 else None
        axes.plot(steps, values, color=PALETTE[colour], label=label, linewidth=1.8, marker=marker)
    axes.set_title(title, pad=16)
    axes.set_xlim(left=0.0, right=float(rows[-1]["step"]) if rows else None)
    axes.set_ylabel(unit)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if panel == "bc_loss" and highest > 0.0:
        axes.set_yscale("log")
    if panel == "interventions":
        axes.set_ylim(bottom=0.0)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    if len(curves) > 1:
        axes.legend()
    axes.axvline(boundary, color=GREY, linewidth=1.0, linestyle="--")
    for name, side, shift in (("imitation", "right", -4), ("mixed", "left", 4)):
        axes.annotate(
            name, (boundary, 1.0), (shift, 3), xycoords=axes.get_xaxis_transform(),
            textcoords="offset points", ha=side, fontsize=8, color=PALETTE["text"],
        )  # fmt: skip
