"""Two drives of the same seed side by side: pure diffusion left, projected and shielded right."""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
from matplotlib.figure import Figure

from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.rig import Rig
from irl_dal.evaluation.rollout import drive_episode
from irl_dal.figures.panels import (
    CHASE_SHAPE,
    DPI,
    CommandPlot,
    FilmFrame,
    MovingFigure,
    empty_picture,
    film_writer,
)
from irl_dal.figures.style import PALETTE
from irl_dal.loop import ControlLoop, Observation

SIDE = 640  # of a drive's square half [px]
CODEC = ["-crf", "40", "-b:v", "0", "-deadline", "realtime", "-cpu-used", "7", "-row-mt", "0"]
"""Of VP9: small, and played by every browser."""

OUTCOMES = {"success": "goal reached", "collision": "collision", "off_road": "off the road"}


class _Half:
    """Title, chase view and commands of a drive, drawn while it is driven."""

    def __init__(self, loop: ControlLoop, title: str) -> None:
        self._loop = loop
        self._frames: list[FilmFrame] = []
        self._broken = 0
        figure = Figure(figsize=(SIDE / DPI, SIDE / DPI), dpi=DPI, facecolor="white")
        figure.text(0.024, 0.955, title, fontsize=15, weight="bold")
        self._state = figure.text(0.976, 0.955, "", fontsize=12, ha="right", animated=True)
        height = CHASE_SHAPE[0] / SIDE
        self._chase = empty_picture(figure.add_axes((0.0, 0.36875, 1.0, height)), CHASE_SHAPE)
        self._plots = [
            CommandPlot(figure.add_axes((left, 0.085, 0.38, 0.23)), component, loop.limits)
            for component, left in enumerate((0.09, 0.59))
        ]
        self._moving = MovingFigure(figure)

    def add(self, info: Mapping[str, Any]) -> None:
        """Take in the moment after the reset or after a step."""
        frame = FilmFrame.of(len(self._frames) * self._loop.limits.dt, info)
        if self._frames:
            violated = self._loop.limits.violated(frame.executed, self._frames[-1].executed)
            self._broken += violated
        self._frames.append(frame)

    def picture(self, outcome: str = "") -> bytes:
        """The moment that was taken in last, as a JPEG file: a raw one takes 1.2 MB."""
        self._chase.set_data(np.asarray(self._loop.render()))
        for plot in self._plots:
            plot.update(self._frames)
        words = f"{self._broken} of {len(self._frames) - 1} commands out of bounds"
        colour = PALETTE["plan" if self._broken else "text"]
        self._state.set(text=f"{outcome} · {words}" if outcome else words, color=colour)
        commands = [artist for plot in self._plots for artist in plot.artists]
        picture = self._moving.draw([self._chase, *commands, self._state])
        return imageio.imwrite("<bytes>", picture, extension=".jpg", quality=95)


def record_drive(rig: Rig, title: str, seed: int, duration: float) -> tuple[Episode, list[bytes]]:
    """Drive an episode; its log, and a picture of each moment of its first `duration` seconds."""
    half = _Half(rig.loop, title)
    pictures: list[bytes] = []
    last: dict[str, Any] = {}
    count = round(duration / rig.loop.limits.dt)

    def watch(_observation: Observation, info: Mapping[str, Any]) -> None:
        last.update(info)
        if len(pictures) < count:
            half.add(info)
            pictures.append(half.picture())

    episode = drive_episode(rig.loop, rig.agent, seed, watch)
    if len(pictures) > episode.steps:
        ends = (words for key, words in OUTCOMES.items() if last[key])
        pictures[-1] = half.picture(next(ends, "time is up"))
    return episode, pictures


def film_pair(path: Path, halves: Sequence[Sequence[bytes]], rate: float) -> None:
    """Film the pictures of two drives side by side [1/s]; the shorter one waits at its end."""
    ends = [half[-1] for half in halves]
    options = {"format": "FFMPEG", "codec": "libvpx-vp9", "quality": None, "output_params": CODEC}
    with film_writer(path, rate, **options) as film:
        for moment in zip_longest(*halves):
            shown = [picture or end for picture, end in zip(moment, ends, strict=True)]
            film.append_data(np.hstack([imageio.imread(picture) for picture in shown]))
