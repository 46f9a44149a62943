"""The page of a report: training dynamics, the table as dots, paths through one curve, origins."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.road import Road
from irl_dal.figures.document import FigureWithCaption, render_page
from irl_dal.figures.style import GREY, PALETTE, VARIANT_COLOURS, Array, drawing
from irl_dal.figures.table import Cell, NumberTable
from irl_dal.figures.top_view import LINES, SPACING
from irl_dal.storage.atomic import write_text
from irl_dal.sweep.across_runs import band
from irl_dal.sweep.collection import Collection
from irl_dal.sweep.paper_table import COLUMNS, Estimates, label, paper_table
from irl_dal.sweep.remarks import remarks
from irl_dal.sweep.result import OVERLAY_SEED

_PANELS = (
    ("rollout/episode_return", "Return, mean of the last 20 episodes", False),
    ("bc/loss", "Behaviour cloning loss, held out", False),
    ("rollout/intervention_rate", "Interventions: steps with the planner on", True),
)

_VIEW = 55.0, 28.0  # how far around the sharpest bend the overlay reaches, across and up [m]


def sweep_figures(
    collection: Collection, estimates: Estimates, rng: np.random.Generator
) -> list[FigureWithCaption]:
    """Draw everything that a report shows."""
    return [
        FigureWithCaption(
            "scores",
            _draw_scores(collection, estimates),
            "Every number of the table",
            "Diamonds: interquartile mean over the runs; bars: 95 % stratified bootstrap interval; "
            "dots: single runs.",
        ),
        FigureWithCaption(
            "dynamics",
            _draw_dynamics(collection, rng),
            "Training dynamics",
            "Interquartile mean and 95 % interval over the runs, running mean of five rows. "
            "Dashed: the policy begins to drive.",
        ),
        FigureWithCaption(
            "overlay",
            _draw_overlay(collection),
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
        rows.append((run.name, VARIANT_COLOURS.get(run.variant, GREY), list(map(Cell, cells))))
    return NumberTable("The runs", headings, rows)


def _draw_dynamics(collection: Collection, rng: np.random.Generator) -> Figure:
    """Return, cloning loss and interventions over the training, bands over the runs."""
    with drawing(10.5, 8.4) as figure:
        axes = figure.subplots(len(_PANELS), 1, sharex=True)
        for one, (column, title, percent) in zip(axes, _PANELS, strict=True):
            for variant in collection.variants:
                runs = collection.of(variant)
                curve = band(runs, column, rng)
                if curve is None:
                    continue
                colour = VARIANT_COLOURS.get(variant, GREY)
                words = f"{label(variant)}, {len(runs)} run{'s' * (len(runs) > 1)}"
                middle, low, high = map(_smoothed, (curve.middle, curve.low, curve.high))
                one.plot(curve.steps, middle, color=colour, linewidth=1.8, label=words)
                one.fill_between(curve.steps, low, high, color=colour, alpha=0.15, linewidth=0.0)
            one.set_title(title)
            if percent:
                one.yaxis.set_major_formatter(PercentFormatter(1.0))
                one.set_ylim(bottom=0.0)
            if collection.boundary is not None:
                one.axvline(collection.boundary, color=GREY, linewidth=1.0, linestyle="--")
        axes[1].set_yscale("log")
        axes[-1].set_xlabel("environment step")
        axes[-1].xaxis.set_major_formatter(EngFormatter(sep=""))
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _draw_scores(collection: Collection, estimates: Estimates) -> Figure:
    """Every column of the table: interquartile means with intervals, each run a small dot."""
    variants = collection.variants[::-1]
    with drawing(10.5, 4.6) as figure:
        axes = figure.subplots(2, len(COLUMNS) // 2, sharey=True, squeeze=False).ravel()
        for one, column in zip(axes, COLUMNS, strict=True):
            for place, variant in enumerate(variants):
                runs = [result.score(column.key) for result in collection.of(variant)]
                dots = column.scale * np.array([run for run in runs if run is not None])
                colour = VARIANT_COLOURS.get(variant, GREY)
                height = np.full(len(dots), float(place))
                one.plot(dots, height, ".", color=colour, alpha=0.45, markersize=5.0)
                found = estimates[variant][column.key]
                if bounds := found.bounds:
                    ends = [column.scale * bound for bound in bounds]
                    one.plot(ends, [place, place], color=colour, linewidth=4.0, alpha=0.35)
                if found.value is not None:
                    one.plot(column.scale * found.value, place, "D", color=colour, markersize=5.5)
            one.set_title(column.heading)
        axes[0].set_yticks(range(len(variants)), [label(variant) for variant in variants])
        axes[0].set_ylim(-0.6, len(variants) - 0.4)
    return figure


def _draw_overlay(collection: Collection) -> Figure:
    """The first run of each variant in the sharpest bend of the same episode."""
    with closing(CityEnv(CityConfig())) as env:
        env.reset(seed=OVERLAY_SEED)
        road = env.scene().road
    with drawing(10.5, 6.4) as figure:
        axes = figure.subplots()
        axes.grid(visible=False)
        middle = _road(axes, road)
        for variant in collection.variants:
            first = collection.of(variant)[0]
            path = np.array(first.path)
            colour = VARIANT_COLOURS.get(variant, GREY)
            words = label(variant) + ("" if first.arrived else ", did not arrive")
            axes.plot(*path.T, color=colour, linewidth=1.8, label=words)
            if not first.arrived:
                axes.plot(*path[-1], marker="X", color=colour, markersize=9.0, clip_on=True)
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axes.set_xlim(middle[0] - _VIEW[0], middle[0] + _VIEW[0])
        axes.set_ylim(middle[1] - _VIEW[1], middle[1] + _VIEW[1])
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def _smoothed(values: Array, width: int = 5) -> Array:
    """Running mean over `width` rows, shorter at the ends."""
    ones = np.ones(min(width, len(values)))
    return np.convolve(values, ones, "same") / np.convolve(np.ones(len(values)), ones, "same")


def _road(axes: Axes, road: Road) -> Array:
    """Draw the road's lines; gives the place of its sharpest bend (2,) [m]."""
    for offset, (line, width, style) in LINES.items():
        points = road.line(float(road.s[0]), float(road.s[-1]), offset, SPACING)
        colour = GREY if line == "edge" else PALETTE[line]  # white edges cannot be seen here
        axes.plot(*points.T, color=colour, linewidth=0.75 * width, linestyle=style)
    inside = (road.s > 40.0) & (road.s < road.length - 40.0)
    sharpest = int(np.argmax(np.abs(road.curvature) * inside))
    return np.asarray(road.points[sharpest])
