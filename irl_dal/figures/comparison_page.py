"""The page of a comparison: one file, no network, every figure in it."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from irl_dal.comparison.drive import Subject, arm_bench
from irl_dal.comparison.settings import Arm
from irl_dal.comparison.table import ACTIVATIONS, RIDE_COLUMNS, SAFETY_COLUMNS, STATE_COLUMNS, cell
from irl_dal.comparison.trace import telling_context, trace_plan
from irl_dal.comparison.verdict import champion, findings
from irl_dal.evaluation.episode import Episode
from irl_dal.figures import FigureWithCaption, render, write_pictures
from irl_dal.figures.comparison import (
    draw_commands,
    draw_denoising,
    draw_differences,
    draw_numbers,
    draw_paths,
)
from irl_dal.figures.comparison_film import film_pair
from irl_dal.figures.style import MODE_COLOURS
from irl_dal.storage.atomic import write_text

__all__ = ["render_page", "write_page"]


def write_page(subject: Subject, report: Mapping[str, Any]) -> None:
    """Draw and film what the report needs and write the page beside it.

    The figures are written as pictures too, into `figures/`.
    """
    drives, film = _drives(subject, report)
    figures = [*_plan_figures(subject, report), *_number_figures(report)]
    if drives:
        figures.insert(2, _command_figure(subject, drives))
    write_pictures(figures, subject.store.folder / "figures")
    write_text(subject.store.page, render_page(report, figures, film))


def render_page(
    report: Mapping[str, Any], figures: Sequence[FigureWithCaption], film: Path | None
) -> str:
    """Fill the template.

    Args:
        report: Of the comparison.
        figures: In their order.
        film: WebM file that is embedded; None without one.
    """
    video = None if film is None else base64.b64encode(film.read_bytes()).decode("ascii")
    return render(
        "comparison.html.j2",
        figures,
        report=report,
        findings=findings(report),
        activations=ACTIVATIONS,
        safety_columns=SAFETY_COLUMNS,
        ride_columns=RIDE_COLUMNS,
        state_columns=STATE_COLUMNS,
        cell=cell,
        colours=MODE_COLOURS,
        video=video,
    )


def _drives(
    subject: Subject, report: Mapping[str, Any]
) -> tuple[list[tuple[str, str, Episode]], Path | None]:
    """Pure diffusion and the best projected arm on one seed, filmed."""
    duration = subject.comparison.film_duration
    if duration <= 0.0:
        return [], None
    activation = subject.comparison.activations[-1]
    pure = Arm(activation, "none", shielded=False)
    best = Arm(activation, champion(report), shielded=True)
    film = subject.store.film
    with (
        arm_bench(subject, pure, "rgb_array") as left,
        arm_bench(subject, best, "rgb_array") as right,
    ):
        titles = (f"{pure.label}, no shield", best.label)
        seed = subject.comparison.first_seed
        logs = film_pair(film, (left, right), titles, seed, duration)
    arms = zip(titles, (pure, best), logs, strict=True)
    return [(title, arm.projection, log) for title, arm, log in arms], film


def _command_figure(
    subject: Subject, drives: Sequence[tuple[str, str, Episode]]
) -> FigureWithCaption:
    figure = draw_commands(drives, subject.config.limits, subject.comparison.film_duration)
    words = ACTIVATIONS[subject.comparison.activations[-1]]
    return FigureWithCaption(
        "commands",
        figure,
        "Steering and speed against their bounds",
        f"The drives of the film, {words}. Dashed: bounds. Red dots: executed commands that break "
        "one. Below: how much of the nearest rate or lateral bound a command takes, 1 is all of "
        "it; logarithmic above 2.",
    )


def _plan_figures(subject: Subject, report: Mapping[str, Any]) -> list[FigureWithCaption]:
    """One plan being denoised, and where its candidates lead."""
    first = subject.comparison.activations[0]
    arms = [Arm(first, "none", True), Arm(first, champion(report), True)]
    seed, context = telling_context(subject, arms)
    traces = [trace_plan(subject, arm, context, seed) for arm in arms]
    limits = subject.config.limits
    count = subject.comparison.candidates
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


def _number_figures(report: Mapping[str, Any]) -> list[FigureWithCaption]:
    """Values and paired differences for each activation."""
    figures = []
    for activation in report["settings"]["activations"]:
        words = ACTIVATIONS[activation]
        figures += [
            FigureWithCaption(
                f"numbers_{activation}",
                draw_numbers(report, activation),
                f"The arms side by side, {words}",
                "Dots: values. Bars: 95 % bootstrap intervals over episodes. Filled: with the "
                "shield; hollow: without.",
            ),
            FigureWithCaption(
                f"differences_{activation}",
                draw_differences(report, activation),
                f"Paired differences from pure diffusion, {words}",
                "Each arm minus mode none without a shield, on the same seeds. A bar that does not "
                "touch zero is a difference at 95 %.",
            ),
        ]
    return figures
