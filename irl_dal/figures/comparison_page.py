"""The page of a comparison: numbers with intervals, a plan being denoised, commands in bounds."""

import base64
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from irl_dal.comparison.config import Setting
from irl_dal.comparison.drive import ComparisonJob, setting_rig
from irl_dal.comparison.planning import DenoisingTrace, most_violating_state, trace_plan
from irl_dal.comparison.presentation import (
    ACTIVATIONS,
    RIDE_COLUMNS,
    SAFETY_COLUMNS,
    best_projection,
    comparison_tables,
    conclusions,
)
from irl_dal.envs.road import LANE_WIDTH
from irl_dal.evaluation.episode import Episode
from irl_dal.figures.comparison_film import film_pair, record_drive
from irl_dal.figures.document import FigureWithCaption, render_page, write_pictures
from irl_dal.figures.style import GREY, MODE_COLOURS, PALETTE, Array, drawing
from irl_dal.figures.table import Cell, Column, NumberTable
from irl_dal.planner import PlanningContext
from irl_dal.planner.energy.clearance import scan_points
from irl_dal.planner.projection import defect
from irl_dal.planner.rollout import ego_rollout
from irl_dal.storage.atomic import write_text
from shield import ActuatorLimits


def write_comparison_page(job: ComparisonJob, results: Mapping[str, Any]) -> None:
    """Draw and film what the page shows and write it; the figures are written as PNG files too."""
    filmed = job.comparison.film_duration > 0.0
    commands = [_command_figure(job, results)] if filmed else []
    figures = [*_plan_figures(job, results), *commands, *_number_figures(results)]
    write_pictures(figures, job.out / "figures")
    write_text(job.page, comparison_page(results, figures, job.film if filmed else None))


def comparison_page(
    results: Mapping[str, Any], figures: Sequence[FigureWithCaption], film: Path | None
) -> str:
    """Fill the template."""
    extent = results["settings"]
    words = ACTIVATIONS[extent["activations"][-1]]
    video = "" if film is None else base64.b64encode(film.read_bytes()).decode("ascii")
    caption = (
        f"Seed {extent['first_seed']}, {words}: pure diffusion on the left, projected and shielded "
        "on the right."
    )
    return render_page(
        "Pure against projected diffusion",
        conclusions(results),
        comparison_tables(results),
        figures,
        [_origin(results)],
        (video, caption),
    )


def _origin(results: Mapping[str, Any]) -> NumberTable:
    lines = {
        "run": f"{results['variant']}, training seed {results['training_seed']}",
        "configuration": results["config_hash"],
        "commit": results["commit"],
        "planner": f"{results['sampler']}, default projection {results['default_projection']}",
        "latencies": f"wall clock, one thread, {results['settings']['n_jobs']} processes at a time",
        "definitions": "irl_dal/evaluation/metrics.py; all numbers are in compare.json",
    }
    rows = [(name, "", [Cell(str(text))]) for name, text in lines.items()]
    return NumberTable("Where this comes from", [""], rows)


def _command_figure(job: ComparisonJob, results: Mapping[str, Any]) -> FigureWithCaption:
    """Film pure diffusion and the best projection on one seed, and draw their commands."""
    extent, activation = job.comparison, job.comparison.activations[-1]
    pure = Setting(activation, "none", shielded=False)
    best = Setting(activation, best_projection(results), shielded=True)
    drives, halves = [], []
    for setting, title in ((pure, f"{pure.label}, no shield"), (best, best.label)):
        with setting_rig(job, setting, "rgb_array") as rig:
            episode, half = record_drive(rig, title, extent.first_seed, extent.film_duration)
        drives.append((title, setting.projection, episode))
        halves.append(half)
    film_pair(job.film, halves, 1.0 / job.config.limits.dt)
    return FigureWithCaption(
        "commands",
        _draw_commands(drives, job.config.limits, extent.film_duration),
        "Steering and speed against their bounds",
        f"The drives of the film, {ACTIVATIONS[activation]}. Dashed: bounds. Red dots: executed "
        "commands that break one. Below: how much of the nearest rate or lateral bound a command "
        "takes, 1 is all of it; logarithmic above 2.",
    )


def _plan_figures(job: ComparisonJob, results: Mapping[str, Any]) -> list[FigureWithCaption]:
    """One plan being denoised, and where its candidates lead."""
    first = job.comparison.activations[0]
    settings = [Setting(first, "none", True), Setting(first, best_projection(results), True)]
    seed, context = most_violating_state(job, settings[0])
    traces = [trace_plan(job, setting, context, seed) for setting in settings]
    limits = job.config.limits
    count = job.comparison.candidates
    state = f"A risky state of seed {seed}, {count} plans, the same noise in both."
    return [
        FigureWithCaption(
            "denoising",
            _draw_denoising(traces, context, limits),
            "One plan being denoised, without and with projection",
            f"{state} Each line is the clean estimate of one plan at diffusion step k, after "
            "guidance and projection. Shaded: what box and rate leave from the last executed "
            "command on. Red dots: commands that break a bound.",
        ),
        FigureWithCaption(
            "paths",
            _draw_paths(traces, context, limits),
            "Where these plans lead",
            "From above, the rear axle at (0, 0); grey dots are LiDAR returns.",
        ),
    ]


def _number_figures(results: Mapping[str, Any]) -> list[FigureWithCaption]:
    figures = []
    for activation in results["settings"]["activations"]:
        words = ACTIVATIONS[activation]
        figures += [
            FigureWithCaption(
                f"numbers_{activation}",
                _draw_numbers(results, activation),
                f"The settings side by side, {words}",
                "Dots: values. Bars: 95 % bootstrap intervals over episodes. Filled: with the "
                "shield; hollow: without.",
            ),
            FigureWithCaption(
                f"differences_{activation}",
                _draw_numbers(results, activation, "_vs_none"),
                f"Paired differences from pure diffusion, {words}",
                "Each setting minus mode none without a shield, on the same seeds. A bar that does "
                "not touch zero is a difference at 95 %.",
            ),
        ]
    return figures


SHOWN = [  # numbers that get a panel
    *("command_violation_rate", "success", "collisions_per_1k_steps"),
    *("correction_norm", "comfort_rms_jerk", "ade_m"),
]
SHORTEST_VIEW = 10.0  # [m] ahead, so that the lane can be seen around a slow plan
DIGITS = 1e-9  # share of a bound below which a difference is rounding
SHARES = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0)  # ticks of the used share of the bounds
DEGREE = float(np.degrees(1.0))


def _draw_numbers(results: Mapping[str, Any], activation: str, end: str = "") -> Figure:
    """Every setting with its intervals, a panel per number; `end` chooses paired differences."""
    settings = [
        arm
        for arm in results["arms"].values()
        if arm["activation"] == activation
        and not (end and arm["projection"] == "none" and not arm["shielded"])
    ]
    words = "difference from none, no shield, on the same seeds" if end else "95 % intervals"
    columns = {column.key: column for column in SAFETY_COLUMNS + RIDE_COLUMNS}
    with drawing(10.5, 0.42 * len(settings) + 2.6) as figure:
        axes = figure.subplots(2, 3, sharey=True).ravel()
        for one, key in zip(axes, SHOWN, strict=True):
            _panel(one, columns[key], settings, end)
        axes[0].set_yticks(range(len(settings)), [numbers["label"] for numbers in settings])
        axes[0].set_ylim(len(settings) - 0.5, -0.5)
        figure.supxlabel(f"{words}, {ACTIVATIONS[activation]}", fontsize=9.5)
    return figure


def _panel(axes: Axes, column: Column, settings: Sequence[Mapping[str, Any]], end: str) -> None:
    """One number: a dot and an interval per setting; hollow without a shield."""
    for row, numbers in enumerate(settings):
        value, bounds = numbers.get(f"{column.key}{end}"), numbers.get(f"{column.key}{end}_ci95")
        if value is None or bounds is None:
            continue
        colour = MODE_COLOURS[numbers["projection"]]
        ends = [column.scale * bound for bound in bounds]
        axes.plot(ends, [row, row], color=colour, linewidth=2.2, alpha=0.55)
        face = colour if numbers["shielded"] else "white"
        dot = column.scale * value
        axes.plot(dot, row, "o", color=colour, markerfacecolor=face, markersize=6.5)
    if end:
        axes.axvline(0.0, color=GREY, linewidth=1.0)
    axes.grid(axis="y", visible=False)
    arrow = {1: "  (more is better)", -1: "  (less is better)", 0: ""}[column.better]
    axes.set_title(f"{column.heading}{arrow if not end else ''}")


def _draw_denoising(
    traces: Sequence[DenoisingTrace], context: PlanningContext, limits: ActuatorLimits
) -> Figure:
    """Steering of all candidates over the plan at some denoising steps, a row per mode."""
    shown = sorted({round(x) for x in np.linspace(0, len(traces[0].k) - 1, 5)})
    horizon = traces[0].estimates.shape[2]
    steps = np.arange(1, horizon + 1)
    steering, cone = float(context.previous[0]), np.arange(horizon + 1)
    reach = float(limits.max_increase[0]) * cone  # what box and rate leave over the plan
    low = DEGREE * np.maximum(steering - reach, limits.low[0])
    high = DEGREE * np.minimum(steering + reach, limits.high[0])
    with drawing(10.5, 2.5 * len(traces) + 0.5) as figure:
        grid = figure.subplots(len(traces), len(shown), sharex=True, sharey=True, squeeze=False)
        for row, trace in zip(grid, traces, strict=True):
            for axes, index in zip(row, shown, strict=True):
                axes.fill_between(cone, low, high, color=GREY, alpha=0.22, linewidth=0.0)
                for plan in trace.estimates[index]:
                    bad = _broken(plan, context.previous, limits)
                    line = dict(color=MODE_COLOURS[trace.label], linewidth=0.9, alpha=0.75)
                    axes.plot(steps, DEGREE * plan[:, 0], **line)
                    _mark(axes, steps[bad], DEGREE * plan[bad, 0])
            row[0].set_ylabel(f"{trace.label}\nsteering [°]")
        for axes, index in zip(grid[0], shown, strict=True):
            axes.set_title(f"k = {traces[0].k[index]}")
        for axes in grid[-1]:
            axes.set_xlabel("step of the plan")
            axes.set_xticks(range(0, horizon + 1, max(1, horizon // 4)))
    return figure


def _draw_paths(
    traces: Sequence[DenoisingTrace], context: PlanningContext, limits: ActuatorLimits
) -> Figure:
    """Where the candidates lead, seen from above, with the scan; a panel per mode."""
    points, _ = scan_points(context)
    longest = limits.dt * max(float(t.plan.candidates[..., 1].sum(1).max()) for t in traces)
    reach = max(SHORTEST_VIEW, 2.0 + longest)
    with drawing(10.5, 0.9 + 10.0 / len(traces) * 6.0 / (reach + 1.0)) as figure:
        for axes, trace in zip(figure.subplots(1, len(traces), sharey=True), traces, strict=True):
            path = ego_rollout(trace.plan.candidates, limits.wheelbase, limits.dt)
            zero = np.zeros((len(path.x), 1))
            x, y = np.hstack([zero, path.x]), np.hstack([zero, path.y])
            _lane(axes, context, reach)
            axes.plot(points[:, 0], points[:, 1], ".", color=GREY, markersize=4.0)
            axes.plot(x.T, y.T, color=MODE_COLOURS[trace.label], linewidth=1.0, alpha=0.8)
            bad = sum(_broken(p, context.previous, limits).any() for p in trace.plan.candidates)
            axes.set_title(f"{trace.label}: {bad} of {len(x)} plans break a bound")
            axes.set(xlim=(-1.0, reach), ylim=(-3.0, 3.0), aspect="equal", xlabel="ahead [m]")
        figure.axes[0].set_ylabel("to the left [m]")
    return figure


def _draw_commands(
    drives: Sequence[tuple[str, str, Episode]], limits: ActuatorLimits, duration: float
) -> Figure:
    """Steering, speed and used share of the bounds over `duration` [s], a column per drive."""
    with drawing(10.5, 6.2) as figure:
        grid = figure.subplots(3, len(drives), sharex=True, sharey="row", squeeze=False)
        for column, (label, mode, episode) in zip(grid.T, drives, strict=True):
            count = min(episode.steps, round(duration / limits.dt))
            time = limits.dt * np.arange(count)
            done, before = episode.executed_command[:count], episode.previous_command[:count]
            pairs = zip(done, before, strict=True)
            bad = np.array([limits.violated(*pair) for pair in pairs])
            used = _used(done, before, limits)
            curves = (DEGREE * done[:, 0], 1.3), (done[:, 1], 1.3), (used, 1.1)
            for axes, (values, width) in zip(column, curves, strict=True):
                axes.plot(time, values, color=MODE_COLOURS[mode], linewidth=width)
                _mark(axes, time[bad], values[bad])
            column[0].set_title(f"{label}: {int(bad.sum())} of {count} commands out of bounds")
            column[2].set_xlabel("time [s]")
        low, high = limits.low, limits.high
        bounds = (DEGREE * low[0], DEGREE * high[0]), (low[1], high[1]), (1.0,)
        for row, ends in zip(grid, bounds, strict=True):
            for axes, value in product(row, ends):
                axes.axhline(value, color=GREY, linewidth=1.0, linestyle="--")
        grid[2, 0].set_yscale("symlog", linthresh=2.0)
        grid[2, 0].set_yticks(SHARES, [f"{share:g}" for share in SHARES])
        grid[2, 0].minorticks_off()
        names = ("steering [°]", "speed [m/s]", "largest share of a\nrate or lateral bound")
        for axes, name in zip(grid[:, 0], names, strict=True):
            axes.set_ylabel(name)
    return figure


def _mark(axes: Axes, x: Array, y: Array) -> None:
    axes.plot(x, y, ".", color=PALETTE["violation"], markersize=4.0)


def _used(done: Array, before: Array, limits: ActuatorLimits) -> Array:
    """Largest share of a rate bound or of the lateral bound that each command takes (T,)."""
    change = done - before
    share = np.maximum(change / limits.max_increase, -change / limits.max_decrease).max(axis=1)
    if limits.max_lateral_acceleration is not None:
        lateral = np.abs(limits.lateral_acceleration(done)) / limits.max_lateral_acceleration
        share = np.maximum(share, lateral)
    return np.asarray(np.maximum(share, 0.0))


def _broken(plan: Array, previous: Array, limits: ActuatorLimits) -> NDArray[np.bool_]:
    """Which commands of a plan (H, 2) break a bound (H,).

    Estimates come out of the loop in normalised units: their last digits do not count.
    """
    before = np.vstack([previous, plan[:-1]])
    return np.asarray(defect(plan[:, None], before[:, None], limits) > DIGITS)


def _lane(axes: Axes, context: PlanningContext, reach: float) -> None:
    """Edges of the own direction's lanes as they are estimated, to second order."""
    lane = context.lane
    if not lane.valid:
        return
    x = np.linspace(-1.0, reach, 30)
    centre = -lane.lateral_offset - lane.heading_error * x + 0.5 * lane.curvature * x**2
    for edge in (-0.5 * LANE_WIDTH, 0.5 * LANE_WIDTH, 1.5 * LANE_WIDTH):
        axes.plot(x, centre + edge, color=GREY, linewidth=1.0, linestyle=(0, (6, 4)))
