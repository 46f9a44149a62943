"""Pages that people keep: one file each, no network, every figure in it."""

from irl_dal.pages.document import Shown, render, write_pictures
from irl_dal.pages.style import GREY, drawing, to_svg

__all__ = ["GREY", "Shown", "drawing", "render", "to_svg", "write_pictures"]
