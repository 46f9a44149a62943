"""A page from a template and figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from irl_dal.figures.style import picture, to_svg

__all__ = ["FigureWithCaption", "render", "write_pictures"]


@dataclass(frozen=True, slots=True)
class FigureWithCaption:
    """A figure with its words.

    Attributes:
        name: Of its element and of its file.
        figure: Drawn with `drawing`.
        title: Above it.
        caption: Below it.
    """

    name: str
    figure: Figure
    title: str
    caption: str

    @property
    def svg(self) -> Markup:
        """For the page; matplotlib's own drawing, nothing of a user's."""
        return Markup(to_svg(self.figure, self.name))


def render(template: str, figures: Sequence[FigureWithCaption], **content: Any) -> str:
    """Fill a template that extends `base.html.j2`.

    Args:
        template: Its name.
        figures: In their order.
        content: What else the template asks for; words are escaped.
    """
    environment = Environment(
        loader=PackageLoader("irl_dal.figures"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(figures=figures, **content)


def write_pictures(figures: Sequence[FigureWithCaption], folder: Path) -> None:
    """Write figures as PNG files too, for other documents."""
    folder.mkdir(parents=True, exist_ok=True)
    for shown in figures:
        picture(shown.figure, str(folder / f"{shown.name}.png"))
