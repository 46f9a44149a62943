"""A film of one drive: chase view, camera, top view, commands within their bounds, trigger."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from irl_dal.figures.panels import CommandPlot, FilmFrame, StatusPanel
from irl_dal.figures.top_view import TopView
from irl_dal.loop import ControlLoop, Observation
from shield import KinematicBicycle

Array = NDArray[np.float64]

SIZE = (1280, 720)
"""Of a frame [px]; even, as video encoders want it."""

DPI = 100

CHASE_SHAPE = (360, 640)
"""Height and width of the chase view [px]."""


class DriveFilm:
    """Watches a drive and films it; a context manager whose `watch` goes to `drive_episode`.

    What stands still in a frame is drawn once, a frame costs what moves in it.

    Args:
        path: `.mp4` file to write; it appears when the film is complete.
        loop: Loop that is driven; without `render_mode="rgb_array"` the chase view stays empty.
        duration: After so many seconds of the drive nothing more is filmed [s].
    """

    def __init__(self, path: Path, loop: ControlLoop, duration: float) -> None:
        self.path = path
        self._loop = loop
        self._duration = duration
        self._bicycle = KinematicBicycle(loop.limits.wheelbase, loop.limits.dt)
        self._frames: list[FilmFrame] = []
        self._canvas, axes = _layout()
        size = loop.city.config.image_size
        self._chase = _picture(axes["chase"], CHASE_SHAPE)
        self._camera = _picture(axes["camera"], (size, size))
        self._top = TopView(axes["top"], loop.city.config.lidar_range)
        self._status = StatusPanel(axes["status"])
        self._plots = [
            CommandPlot(axes[name], i, loop.limits) for i, name in enumerate(("steering", "speed"))
        ]
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._canvas.figure.bbox)

    def __enter__(self) -> DriveFilm:
        """Open the file."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._partial = self.path.with_name(f".part-{self.path.name}")
        rate = 1.0 / self._loop.limits.dt
        self._writer = imageio.get_writer(self._partial, fps=rate, macro_block_size=2)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the file; an interrupted film leaves none."""
        self._writer.close()
        if kind is None:
            self._partial.replace(self.path)
        else:
            self._partial.unlink(missing_ok=True)

    def watch(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Film the moment after the reset or after a step."""
        time = len(self._frames) * self._loop.limits.dt
        self._frames.append(FilmFrame.of(time, info))
        if time <= self._duration:
            self._writer.append_data(self.frame(observation, info))

    def frame(self, observation: Observation, info: Mapping[str, Any]) -> NDArray[np.uint8]:
        """Draw the moment that was watched last: (720, 1280, 3) uint8."""
        self._camera.set_data(observation["image"])
        view = self._loop.render()
        if isinstance(view, np.ndarray):
            self._chase.set_data(view)
        trail = np.array([frame.pose[:2] for frame in self._frames])
        self._top.update(self._loop.city.scene(), trail, self._plan(info))
        self._status.update(self._frames[-1], info)
        moving: list[Artist] = [self._chase, self._camera]
        moving += [*self._top.artists, *self._status.artists]
        for plot in self._plots:
            plot.update(self._frames)
            moving += plot.artists
        self._canvas.restore_region(self._background)
        for artist in moving:
            assert artist.axes is not None
            artist.axes.draw_artist(artist)
        return np.array(np.asarray(self._canvas.buffer_rgba())[:, :, :3])

    def _plan(self, info: Mapping[str, Any]) -> Array | None:
        """Where the plan of the last step leads, from where it was made (H + 1, 2) [m]."""
        plan = info.get("plan")
        if plan is None:
            return None
        start = self._frames[-2].pose
        return np.vstack([start[:2], self._bicycle.rollout(start, plan.actions)[:, :2]])


def _layout() -> tuple[FigureCanvasAgg, dict[str, Axes]]:
    """An empty frame: the chase view above camera and plots, the top view above the status."""
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI, facecolor="white")
    left = figure.add_gridspec(
        2, 3, left=0.01, right=0.66, top=0.985, bottom=0.075, wspace=0.22, hspace=0.12,
        height_ratios=[1.9, 1.0], width_ratios=[0.8, 1.0, 1.0],
    )  # fmt: skip
    right = figure.add_gridspec(
        2, 1, left=0.705, right=0.99, top=0.985, bottom=0.02, hspace=0.16, height_ratios=[2.9, 1.0]
    )
    axes = {
        "chase": figure.add_subplot(left[0, :]),
        "camera": figure.add_subplot(left[1, 0]),
        "steering": figure.add_subplot(left[1, 1]),
        "speed": figure.add_subplot(left[1, 2]),
        "top": figure.add_subplot(right[0]),
        "status": figure.add_subplot(right[1]),
    }
    return FigureCanvasAgg(figure), axes


def _picture(axes: Axes, shape: tuple[int, int]) -> AxesImage:
    """An empty picture of a height and width [px]."""
    axes.set_axis_off()
    blank = np.full((*shape, 3), 255, np.uint8)
    return axes.imshow(blank, interpolation="nearest", aspect="equal", animated=True)
