"""A film of one drive: chase view, camera, top view, commands within their bounds, trigger."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from irl_dal.figures.panels import (
    CHASE_SHAPE,
    DPI,
    CommandPlot,
    FilmFrame,
    MovingFigure,
    empty_picture,
    status_words,
)
from irl_dal.figures.style import PALETTE, Array
from irl_dal.figures.top_view import TopView
from irl_dal.loop import ControlLoop, Observation
from shield import KinematicBicycle

SIZE = (1280, 720)  # of a frame [px]; even, as video encoders need it


class DriveFilm:
    """Watches a drive and films it: `watch` goes to `drive_episode`.

    Args:
        writer: Of `film_writer`.
        loop: Loop that is driven; without `render_mode="rgb_array"` the chase view stays empty.
        duration: After so many seconds of the drive nothing more is filmed [s].
    """

    def __init__(self, writer: Any, loop: ControlLoop, duration: float) -> None:
        self._writer = writer
        self._loop = loop
        self._duration = duration
        self._bicycle = KinematicBicycle(loop.limits.wheelbase, loop.limits.dt)
        self._frames: list[FilmFrame] = []
        figure, axes = _layout()
        size = loop.city.config.image_size
        self._chase = empty_picture(axes["chase"], CHASE_SHAPE)
        self._camera = empty_picture(axes["camera"], (size, size))
        self._top = TopView(axes["top"], loop.city.config.lidar_range)
        axes["status"].set_axis_off()
        self._status = axes["status"].text(
            0.0, 1.0, "", fontsize=9, va="top", linespacing=1.5, family="monospace", animated=True
        )
        self._plots = [
            CommandPlot(axes[name], i, loop.limits) for i, name in enumerate(("steering", "speed"))
        ]
        self._moving = MovingFigure(figure)

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
        hot = info["risk"].risky or self._frames[-1].triggered
        colour = PALETTE["plan"] if hot else "black"
        self._status.set(text=status_words(self._frames[-1], info), color=colour)
        for plot in self._plots:
            plot.update(self._frames)
        moving: list[Artist] = [self._chase, self._camera, *self._top.artists, self._status]
        return self._moving.draw(moving + [a for plot in self._plots for a in plot.artists])

    def _plan(self, info: Mapping[str, Any]) -> Array | None:
        """Where the plan of the last step leads, from where it was made (H + 1, 2) [m]."""
        plan = info.get("plan")
        if plan is None:
            return None
        start = self._frames[-2].pose
        return np.vstack([start[:2], self._bicycle.rollout(start, plan.actions)[:, :2]])


def _layout() -> tuple[Figure, dict[str, Axes]]:
    """An empty frame: the chase view above camera and plots, the top view above the status."""
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI, facecolor="white")
    left = figure.add_gridspec(
        2, 3, left=0.01, right=0.66, top=0.985, bottom=0.075, wspace=0.22, hspace=0.12,
        height_ratios=[1.9, 1.0], width_ratios=[0.8, 1.0, 1.0],
    )  # fmt: skip
    right = figure.add_gridspec(
        2, 1, left=0.705, right=0.99, top=0.985, bottom=0.02, hspace=0.16, height_ratios=[2.9, 1.0]
    )
    names = ("chase", "camera", "steering", "speed", "top", "status")
    places = (left[0, :], left[1, 0], left[1, 1], left[1, 2], right[0], right[1])
    return figure, dict(zip(names, map(figure.add_subplot, places), strict=True))
