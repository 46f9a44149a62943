"""The page of a comparison."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from irl_dal.comparison.columns import ACTIVATIONS, comparison_tables
from irl_dal.comparison.conclusions import best_projection, conclusions
from irl_dal.comparison.drive import ComparisonJob, setting_rig
from irl_dal.comparison.planning import most_violating_state, trace_plan
from irl_dal.comparison.settings import Setting
from irl_dal.figures.comparison import (
    draw_commands,
    draw_denoising,
    draw_differences,
    draw_numbers,
    draw_paths,
)
from irl_dal.figures.comparison_film import film_pair, record_drive
from irl_dal.figures.document import FigureWithCaption, render_page, write_pictures
from irl_dal.figures.table import Cell, NumberTable
from irl_dal.storage.atomic import write_text


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
    """Where the numbers come from."""
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
        draw_commands(drives, job.config.limits, extent.film_duration),
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
            draw_denoising(traces, context, limits),
            "One plan being denoised, without and with projection",
            f"{state} Each line is the clean estimate of one plan at diffusion step k, after "
            "guidance and projection. Shaded: what box and rate leave from the last executed "
            "command on. Red dots: commands that break a bound.",
        ),
        FigureWithCaption(
            "paths",
            draw_paths(traces, context, limits),
            "Where these plans lead",
            "From above, the rear axle at (0, 0); grey dots are LiDAR returns.",
        ),
    ]


def _number_figures(results: Mapping[str, Any]) -> list[FigureWithCaption]:
    """Values and paired differences for each activation."""
    figures = []
    for activation in results["settings"]["activations"]:
        words = ACTIVATIONS[activation]
        figures += [
            FigureWithCaption(
                f"numbers_{activation}",
                draw_numbers(results, activation),
                f"The settings side by side, {words}",
                "Dots: values. Bars: 95 % bootstrap intervals over episodes. Filled: with the "
                "shield; hollow: without.",
            ),
            FigureWithCaption(
                f"differences_{activation}",
                draw_differences(results, activation),
                f"Paired differences from pure diffusion, {words}",
                "Each setting minus mode none without a shield, on the same seeds. A bar that does "
                "not touch zero is a difference at 95 %.",
            ),
        ]
    return figures
