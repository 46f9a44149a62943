"""A page from figures and tables: one file, no network, every figure in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from irl_dal.figures.style import picture, to_svg
from irl_dal.figures.table import NumberTable


@dataclass(frozen=True, slots=True)
class FigureWithCaption:
    """A figure on a page, drawn with `drawing`; `name` is that of its element and of its file."""

    name: str
    figure: Figure
    title: str
    caption: str

    @property
    def svg(self) -> Markup:
        """For the page; matplotlib's own drawing, nothing of a user's."""
        return Markup(to_svg(self.figure, self.name))


def render_page(
    title: str,
    sentences: Sequence[str],
    tables: Sequence[NumberTable],
    figures: Sequence[FigureWithCaption],
    origin: Sequence[NumberTable],
    film: tuple[str, str] = ("", ""),
) -> str:
    """Fill the template; words are escaped."""
    environment = Environment(
        loader=PackageLoader("irl_dal.figures"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html.j2").render(
        title=title, sentences=sentences, tables=tables, figures=figures, origin=origin,
        film=film[0], film_caption=film[1],
    )  # fmt: skip


def write_pictures(figures: Sequence[FigureWithCaption], folder: Path) -> None:
    """Write figures as PNG files too, for other documents."""
    folder.mkdir(parents=True, exist_ok=True)
    for figure in figures:
        picture(figure.figure, str(folder / f"{figure.name}.png"))
