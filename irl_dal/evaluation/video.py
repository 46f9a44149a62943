"""A film of one drive: chase view, camera, top view, commands within their bounds, trigger."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from expert import Mode
from irl_dal.evaluation.top_view import PALETTE, TopView
from irl_dal.loop import ControlLoop, Observation
from shield.vehicle import KinematicBicycle

__all__ = ["DriveFilm"]

Array = NDArray[np.float64]

WINDOW = 10.0
"""Past that the plots show [s]."""

SIZE = (1280, 720)
"""Of a frame [px]; even, as video encoders want it."""

DPI = 100


class DriveFilm:
    """Watches a drive and films it; a context manager whose `watch` goes to `drive_episode`.

    Args:
        path: File to write, `.mp4` or `.gif`; it appears when the film is complete.
        loop: Loop that is driven; without `render_mode="rgb_array"` the chase view stays empty.
        duration: After so many seconds of the drive nothing more is filmed [s].
        every: Film one control step in so many; the film runs in real time anyway.
    """

    def __init__(
        self, path: Path, loop: ControlLoop, duration: float = 30.0, every: int = 1
    ) -> None:
        self.path = path
        self._loop = loop
        self._duration = duration
        self._every = every
        self._bicycle = KinematicBicycle(loop.limits.wheelbase, loop.limits.dt)
        self._moments: list[_Moment] = []
        self._canvas, self._axes = _layout()
        self._top = TopView(self._axes["top"], loop.city.config.lidar_range)

    def __enter__(self) -> DriveFilm:
        """Open the file."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._partial = self.path.with_name(f".part-{self.path.name}")
        rate = 1.0 / (self._loop.limits.dt * self._every)
        style = {"loop": 0} if self.path.suffix == ".gif" else {"macro_block_size": 2}
        self._writer = imageio.get_writer(self._partial, fps=rate, **style)
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
        step = len(self._moments)
        time = step * self._loop.limits.dt
        self._moments.append(_Moment.of(time, info))
        if step % self._every == 0 and time <= self._duration:
            self._writer.append_data(self.frame(observation, info))

    def frame(self, observation: Observation, info: Mapping[str, Any]) -> NDArray[np.uint8]:
        """Draw the moment that was watched last: (720, 1280, 3) uint8."""
        self._picture("camera", observation["image"])
        view = self._loop.render()
        if isinstance(view, np.ndarray):
            self._picture("chase", view)
        self._top.draw(self._loop.city.scene(), self._trail(), self._plan(info))
        limits = self._loop.limits
        steering = float(np.degrees(limits.max_steering))
        self._plot("steering", 0, float(np.degrees(1.0)), (-steering, steering), "steering [°]")
        self._plot("speed", 1, 1.0, (limits.min_speed, limits.max_speed), "speed [m/s]")
        self._say(info)
        self._canvas.draw()
        return np.ascontiguousarray(np.asarray(self._canvas.buffer_rgba())[:, :, :3])

    def _picture(self, name: str, image: NDArray[np.uint8]) -> None:
        axes = self._axes[name]
        if axes.images:
            axes.images[0].set_data(image)
        else:
            axes.imshow(image, interpolation="nearest", aspect="equal")

    def _trail(self) -> Array:
        return np.array([moment.pose[:2] for moment in self._moments])

    def _plan(self, info: Mapping[str, Any]) -> Array | None:
        """Where the plan of the last step leads, from where it was made."""
        plan = info.get("plan")
        if plan is None:
            return None
        start = self._moments[-2].pose
        return np.vstack([start[:2], self._bicycle.rollout(start, plan.actions)[:, :2]])

    def _plot(
        self, name: str, column: int, scale: float, bounds: tuple[float, float], label: str
    ) -> None:
        """One component of the commands in the last seconds, its bounds, the triggered time."""
        axes, moments = self._axes[name], self._moments[-round(WINDOW / self._loop.limits.dt) :]
        time = np.array([moment.time for moment in moments])
        axes.cla()
        margin = 0.08 * (bounds[1] - bounds[0])
        axes.set(ylim=(bounds[0] - margin, bounds[1] + margin), xlabel="time [s]")
        axes.set(xlim=(max(0.0, time[-1] - WINDOW), max(time[-1], WINDOW)))
        axes.set_title(label, loc="left")
        for bound in bounds:
            axes.axhline(bound, color="black", linewidth=0.8, linestyle="--")
        on = np.array([moment.triggered for moment in moments])
        low, high = axes.get_ylim()
        tint = {"color": PALETTE["plan"], "alpha": 0.15, "linewidth": 0.0, "label": "planner on"}
        axes.fill_between(time, low, high, where=on, **tint)
        nominal = scale * np.array([moment.nominal[column] for moment in moments])
        executed = scale * np.array([moment.executed[column] for moment in moments])
        axes.plot(time, nominal, color=PALETTE["muted"], linewidth=1.2, label="before the shield")
        axes.plot(time, executed, color=PALETTE["ego"], linewidth=1.8, label="executed")
        if name == "speed":
            axes.legend(loc="lower right", fontsize=7, framealpha=0.8)

    def _say(self, info: Mapping[str, Any]) -> None:
        """The state of trigger, planner and shield in words."""
        axes, moment = self._axes["words"], self._moments[-1]
        axes.cla()
        axes.set_axis_off()
        mode = Mode(info["mode"]).name.replace("_", " ").lower()
        risk = info["risk"]
        reasons = ", ".join(risk.reasons) if risk.risky else "none"
        certificate = info.get("certificate")
        shield = "–" if certificate is None else str(certificate.status)
        weight = info.get("blend_weight", 0.0)
        lines = [
            ("time", f"{moment.time:.1f} s"),
            ("speed", f"{float(info['speed']):.1f} m/s"),
            ("clearance", f"{float(info['clearance']):.1f} m"),
            ("expert's mode", mode),
            ("risk", reasons),
            ("planner", f"on, weight {weight:.2f}" if moment.triggered else "off"),
            ("shield", shield),
        ]
        for row, (name, value) in enumerate(lines):
            hot = (name == "risk" and risk.risky) or (name == "planner" and moment.triggered)
            colour = PALETTE["plan"] if hot else "black"
            height = 1.0 - (row + 0.5) / len(lines)
            axes.text(0.0, height, name, fontsize=9, va="center", color="#5f6368")
            axes.text(0.36, height, value, fontsize=9, va="center", color=colour, weight="bold")


@dataclass(frozen=True, slots=True)
class _Moment:
    """What the plots remember of a step."""

    time: float
    pose: Array
    nominal: Array
    executed: Array
    triggered: bool

    @classmethod
    def of(cls, time: float, info: Mapping[str, Any]) -> _Moment:
        """Take it from `info`; after a reset nothing was commanded yet."""
        start = np.asarray(info["context"].previous)
        return cls(
            time=time,
            pose=np.asarray(info["pose"], np.float64),
            nominal=np.asarray(info.get("nominal_command", start), np.float64),
            executed=np.asarray(info.get("executed_command", start), np.float64),
            triggered=bool(info.get("triggered", False)),
        )


def _layout() -> tuple[FigureCanvasAgg, dict[str, Axes]]:
    """An empty frame: the chase view above camera and plots, the top view above the words."""
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI, facecolor="white")
    left = figure.add_gridspec(
        2, 3, left=0.01, right=0.66, top=0.985, bottom=0.075, wspace=0.22, hspace=0.12,
        height_ratios=[1.9, 1.0], width_ratios=[0.8, 1.0, 1.0],
    )  # fmt: skip
    right = figure.add_gridspec(
        2, 1, left=0.705, right=0.99, top=0.985, bottom=0.02, hspace=0.14, height_ratios=[2.9, 1.0]
    )
    axes = {
        "chase": figure.add_subplot(left[0, :]),
        "camera": figure.add_subplot(left[1, 0]),
        "steering": figure.add_subplot(left[1, 1]),
        "speed": figure.add_subplot(left[1, 2]),
        "top": figure.add_subplot(right[0]),
        "words": figure.add_subplot(right[1]),
    }
    for name in ("chase", "camera"):
        axes[name].set_axis_off()
    return FigureCanvasAgg(figure), axes
