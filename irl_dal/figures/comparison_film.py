"""Two drives of the same seed side by side: pure diffusion left, projected and shielded right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from irl_dal.evaluation.episode import Episode, EpisodeRecorder
from irl_dal.evaluation.rig import Rig
from irl_dal.figures.panels import CommandPlot, FilmFrame
from irl_dal.figures.style import PALETTE
from irl_dal.loop import Observation
from shield import ActuatorLimits

__all__ = ["film_pair"]

SIZE = (1280, 640)
"""Of a frame [px]."""

DPI = 100

VIEW = (640, 360)
"""Of a chase view, one at the top of each half [px]."""

CODEC = ["-crf", "40", "-b:v", "0", "-deadline", "realtime", "-cpu-used", "7", "-row-mt", "0"]
"""Of VP9: small, and played by every browser."""


@dataclass(slots=True)
class _Drive:
    """One half of the film."""

    bench: Rig
    half: _Half
    recorder: EpisodeRecorder
    observation: Observation
    info: Mapping[str, Any]
    frames: list[FilmFrame] = field(default_factory=list)
    over: bool = False

    @classmethod
    def begin(cls, bench: Rig, half: _Half, seed: int) -> _Drive:
        """Reset with the same noise as an evaluation's."""
        bench.agent.reset(seed)
        observation, info = bench.loop.reset(seed=seed)
        return cls(bench, half, EpisodeRecorder(seed, info), observation, info)

    def step(self) -> None:
        """Drive one step, unless the drive is over."""
        if self.over:
            return
        action = self.bench.agent.act(self.observation, self.info)
        observation, reward, ended, cut, info = self.bench.agent.drive(self.bench.loop, action)
        self.recorder.add(action, float(reward), info)
        self.observation, self.info, self.over = observation, info, ended or cut

    def show(self, limits: ActuatorLimits) -> None:
        """Draw the present moment."""
        if not self.over or not self.frames:
            self.frames.append(FilmFrame.of(len(self.frames) * limits.dt, self.info))
            view = self.bench.loop.render()
            if isinstance(view, np.ndarray):
                self.half.picture = view
        self.half.update(self.frames, self.info, limits, self.over)


class _Half:
    """Title, chase view and the commands of one drive."""

    def __init__(self, figure: Figure, left: float, title: str, limits: ActuatorLimits) -> None:
        self.picture: NDArray[np.uint8] = np.full((*VIEW[::-1], 3), 255, np.uint8)
        self._title = figure.text(left + 0.012, 0.955, title, fontsize=15, weight="bold")
        self._figure = figure
        self._state = figure.text(left + 0.488, 0.955, "", fontsize=12, ha="right", animated=True)
        axes: list[Axes] = [
            figure.add_axes((left + offset, 0.085, 0.19, 0.23)) for offset in (0.045, 0.295)
        ]
        self._plots = [CommandPlot(place, i, limits) for i, place in enumerate(axes)]

    def update(
        self, frames: list[FilmFrame], info: Mapping[str, Any], limits: ActuatorLimits, over: bool
    ) -> None:
        """Show the newest frames and how many commands broke a bound."""
        for plot in self._plots:
            plot.update(frames)
        broken = sum(
            limits.violated(after.executed, before.executed)
            for before, after in zip(frames[:-1], frames[1:], strict=True)
        )
        end = f"{_outcome(info)} · " if over else ""
        self._state.set_text(f"{end}{broken} of {len(frames) - 1} commands out of bounds")
        self._state.set_color(PALETTE["plan"] if broken else PALETTE["text"])

    def draw(self) -> None:
        """Draw what moves."""
        for plot in self._plots:
            for artist in plot.artists:
                assert artist.axes is not None
                artist.axes.draw_artist(artist)
        self._figure.draw_artist(self._state)


def film_pair(
    path: Path, benches: tuple[Rig, Rig], titles: tuple[str, str], seed: int, duration: float
) -> tuple[Episode, Episode]:
    """Film two drives of one seed and log both.

    Args:
        path: WebM file to write; it appears when the film is complete.
        benches: Who drives left and right, each with `render_mode="rgb_array"`.
        titles: StatusPanel above the halves.
        seed: Of the episode.
        duration: After which nothing more is driven [s].

    Returns:
        What was logged of both drives so far.
    """
    limits = benches[0].loop.limits
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    halves = [_Half(figure, 0.5 * i, titles[i], limits) for i in range(2)]
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    drives = [_Drive.begin(bench, half, seed) for bench, half in zip(benches, halves, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".part-{path.name}")
    writer = imageio.get_writer(
        partial, format="FFMPEG", fps=1.0 / limits.dt, codec="libvpx-vp9", quality=None,
        macro_block_size=2, output_params=CODEC,
    )  # fmt: skip
    with writer:
        for _ in range(round(duration / limits.dt)):
            for drive in drives:
                drive.show(limits)
            writer.append_data(_frame(canvas, background, halves))
            for drive in drives:
                drive.step()
            if all(drive.over for drive in drives):
                break
    partial.replace(path)
    first, second = (drive.recorder.finish() for drive in drives)
    return first, second


def _frame(canvas: FigureCanvasAgg, background: Any, halves: list[_Half]) -> NDArray[np.uint8]:
    """What stands still, on it what moves, and the views."""
    canvas.restore_region(background)
    for half in halves:
        half.draw()
    frame = np.array(np.asarray(canvas.buffer_rgba())[:, :, :3])
    for i, half in enumerate(halves):
        height, width = half.picture.shape[:2]
        left = 640 * i + (640 - width) // 2
        frame[44 : 44 + height, left : left + width] = half.picture
    return frame


def _outcome(info: Mapping[str, Any]) -> str:
    words = {"success": "goal reached", "collision": "collision", "off_road": "off the road"}
    return next((text for key, text in words.items() if info[key]), "time is up")
