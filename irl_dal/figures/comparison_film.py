"""Two drives of the same seed side by side: pure diffusion left, projected and shielded right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
from imageio.v2 import get_writer
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.rig import Rig
from irl_dal.evaluation.rollout import drive_episode
from irl_dal.figures.panels import CommandPlot, FilmFrame
from irl_dal.figures.style import PALETTE
from irl_dal.loop import Observation
from irl_dal.planner import ProjectionMode
from shield import ActuatorLimits

Picture = NDArray[np.uint8]

SIZE = (1280, 640)  # of a frame [px]
DPI = 100
TOP = 44  # of the chase views, below the titles [px]
CODEC = ["-crf", "40", "-b:v", "0", "-deadline", "realtime", "-cpu-used", "7", "-row-mt", "0"]
"""Of VP9: small, and played by every browser."""


@dataclass(frozen=True, slots=True)
class Drive:
    """A logged episode and what the film shows of it.

    Attributes:
        title: Words above it.
        mode: Where the plan is projected.
        episode: Log of the whole drive.
        frames: The reset and the steps up to the film's end.
        views: Chase view of each, as a JPEG file: a raw one takes 0.7 MB.
        outcome: How the drive ended.
    """

    title: str
    mode: ProjectionMode
    episode: Episode
    frames: list[FilmFrame]
    views: list[bytes]
    outcome: str

    @classmethod
    def record(
        cls, rig: Rig, title: str, mode: ProjectionMode, seed: int, duration: float
    ) -> Drive:
        """Drive an episode and look at its first `duration` seconds."""
        dt = rig.loop.limits.dt
        frames: list[FilmFrame] = []
        views: list[bytes] = []
        last: dict[str, Any] = {}

        def watch(_observation: Observation, info: Mapping[str, Any]) -> None:
            last.update(info)
            if len(frames) < round(duration / dt):
                frames.append(FilmFrame.of(len(frames) * dt, info))
                view = np.asarray(rig.loop.render(), np.uint8)
                views.append(imageio.imwrite("<bytes>", view, extension=".jpg"))

        episode = drive_episode(rig.loop, rig.agent, seed, watch)
        return cls(title, mode, episode, frames, views, _outcome(last))


class _Half:
    """Title, chase view and the commands of one drive."""

    def __init__(self, figure: Figure, left: float, drive: Drive, limits: ActuatorLimits) -> None:
        self._drive, self._limits = drive, limits
        self._left = round(left * SIZE[0])
        figure.text(left + 0.012, 0.955, drive.title, fontsize=15, weight="bold")
        self._state = figure.text(left + 0.488, 0.955, "", fontsize=12, ha="right", animated=True)
        places = [figure.add_axes((left + offset, 0.085, 0.19, 0.23)) for offset in (0.045, 0.295)]
        self._plots = [CommandPlot(axes, i, limits) for i, axes in enumerate(places)]

    def update(self, step: int) -> list[Artist]:
        """Move to a step of the drive, or to its last one; what has to be drawn."""
        shown = self._drive.frames[: step + 1]
        for plot in self._plots:
            plot.update(shown)
        pairs = zip(shown[1:], shown[:-1], strict=True)
        broken = sum(self._limits.violated(now.executed, before.executed) for now, before in pairs)
        over = step >= self._drive.episode.steps
        end = f"{self._drive.outcome} · " if over else ""
        self._state.set_text(f"{end}{broken} of {len(shown) - 1} commands out of bounds")
        self._state.set_color(PALETTE["plan"] if broken else PALETTE["text"])
        return [*(artist for plot in self._plots for artist in plot.artists), self._state]

    def paste(self, picture: Picture, step: int) -> None:
        """Put the chase view into a frame."""
        view = imageio.imread(self._drive.views[min(step, len(self._drive.views) - 1)])
        height, width = view.shape[:2]
        left = self._left + (SIZE[0] // 2 - width) // 2
        picture[TOP : TOP + height, left : left + width] = view


def film_pair(path: Path, drives: Sequence[Drive], limits: ActuatorLimits) -> None:
    """Film two drives side by side."""
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    halves = [_Half(figure, 0.5 * side, drive, limits) for side, drive in enumerate(drives)]
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".part-{path.name}")
    film = get_writer(
        partial, format="FFMPEG", fps=1.0 / limits.dt, codec="libvpx-vp9", quality=None,
        macro_block_size=2, output_params=CODEC,
    )  # fmt: skip
    with film:
        for step in range(max(len(drive.frames) for drive in drives)):
            film.append_data(_frame(canvas, background, halves, step))
    partial.replace(path)


def _frame(canvas: FigureCanvasAgg, background: Any, halves: Sequence[_Half], step: int) -> Picture:
    """What stands still, on it what moves, and the views."""
    canvas.restore_region(background)
    for half in halves:
        for artist in half.update(step):
            canvas.figure.draw_artist(artist)
    picture = np.array(np.asarray(canvas.buffer_rgba())[:, :, :3])
    for half in halves:
        half.paste(picture, step)
    return picture


def _outcome(info: Mapping[str, Any]) -> str:
    words = {"success": "goal reached", "collision": "collision", "off_road": "off the road"}
    return next((text for key, text in words.items() if info[key]), "time is up")
