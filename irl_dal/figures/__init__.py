"""Pages that people keep: one file each, no network, every figure in it."""

from irl_dal.figures.document import FigureWithCaption, render, write_pictures
from irl_dal.figures.style import GREY, drawing, to_svg

__all__ = ["GREY", "FigureWithCaption", "drawing", "render", "to_svg", "write_pictures"]
