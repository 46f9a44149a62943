"""What films are made of: frames, plots of the commands, words about trigger and shield, a file."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import imageio.v2 as imageio
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from numpy.typing import NDArray

from expert import Mode
from irl_dal.figures.style import PALETTE, Array
from shield import ActuatorLimits

DPI = 100  # of a frame [1/in]
CHASE_SHAPE = (360, 640)  # height and width of the chase view [px]
WINDOW = 10.0  # past that the plots show [s]


@contextmanager
def film_writer(path: Path, rate: float, **options: Any) -> Iterator[Any]:
    """The writer of a film [frames/s] that appears when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".part-{path.name}")
    try:
        # imageio's own context leaves the encoder running when an exception ends it.
        with closing(
            imageio.get_writer(partial, fps=rate, macro_block_size=2, **options)
        ) as writer:
            yield writer
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


class MovingFigure:
    """A figure whose standing parts are drawn once: a frame costs what moves in it."""

    def __init__(self, figure: Figure) -> None:
        self._canvas = FigureCanvasAgg(figure)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def draw(self, artists: Iterable[Artist]) -> NDArray[np.uint8]:
        """The frame (height, width, 3) with `artists` on what stands still."""
        self._canvas.restore_region(self._background)
        for artist in artists:
            self._canvas.figure.draw_artist(artist)
        return np.array(np.asarray(self._canvas.buffer_rgba())[:, :, :3])


def empty_picture(axes: Axes, shape: tuple[int, int]) -> AxesImage:
    """A white picture of a height and width [px]."""
    axes.set_axis_off()
    blank = np.full((*shape, 3), 255, np.uint8)
    return axes.imshow(blank, interpolation="nearest", aspect="equal", animated=True)


@dataclass(frozen=True, slots=True)
class FilmFrame:
    """What the film remembers of a step: commands before and after the shield (2,) [rad, m/s]."""

    time: float  # since the start of the drive [s]
    pose: Array  # true x, y, yaw [m, m, rad]
    nominal: Array
    executed: Array
    triggered: bool  # whether the planner was used

    @classmethod
    def of(cls, time: float, info: Mapping[str, Any]) -> Self:
        """Take it from `info`; after a reset nothing was commanded yet."""
        start = info["context"].previous
        return cls(
            time=time,
            pose=np.asarray(info["pose"], np.float64),
            nominal=np.asarray(info.get("nominal_command", start), np.float64),
            executed=np.asarray(info.get("executed_command", start), np.float64),
            triggered=bool(info.get("triggered", False)),
        )


class CommandPlot:
    """Steering in degrees (component 0) or speed (1) over the last seconds, between its bounds."""

    def __init__(self, axes: Axes, component: int, limits: ActuatorLimits) -> None:
        self._axes = axes
        self._component = component
        self._scale = (float(np.degrees(1.0)), 1.0)[component]
        self._shown = round(WINDOW / limits.dt) + 1
        low, high = self._scale * limits.low[component], self._scale * limits.high[component]
        margin = 0.08 * (high - low)
        self._span = (low - margin, high + margin)
        axes.set(ylim=self._span, xlim=(-WINDOW, 0.0), xlabel="time before now [s]")
        axes.set_title(("steering [°]", "speed [m/s]")[component], loc="left", fontsize=11)
        for bound in (low, high):
            axes.axhline(bound, color="black", linewidth=0.8, linestyle="--")
        looks = (("muted", 1.2, "before the shield"), ("ego", 1.8, "executed"))
        self._nominal, self._executed = (
            axes.plot([], [], color=PALETTE[colour], lw=width, animated=True, label=label)[0]
            for colour, width, label in looks
        )
        self._tint = axes.fill_between([], [], [])
        if component == 1:
            on = Patch(color=PALETTE["plan"], alpha=0.15, label="planner on")
            handles = [self._nominal, self._executed, on]
            axes.legend(handles=handles, loc="lower left", fontsize=7, framealpha=0.8)

    @property
    def artists(self) -> list[Artist]:
        """What has to be drawn, from the back to the front."""
        return [self._tint, self._nominal, self._executed]

    def update(self, frames: Sequence[FilmFrame]) -> None:
        """Show the newest frames."""
        shown = frames[-self._shown :]
        time = np.array([frame.time for frame in shown]) - shown[-1].time
        for line, commands in (
            (self._nominal, [frame.nominal for frame in shown]),
            (self._executed, [frame.executed for frame in shown]),
        ):
            line.set_data(time, self._scale * np.array(commands)[:, self._component])
        self._tint.remove()
        self._tint = self._axes.fill_between(
            time, *self._span, where=[frame.triggered for frame in shown], color=PALETTE["plan"],
            alpha=0.15, linewidth=0.0, animated=True,
        )  # fmt: skip


def status_words(frame: FilmFrame, info: Mapping[str, Any]) -> str:
    """What is going on, in seven lines."""
    risk, certificate = info["risk"], info.get("certificate")
    lines = {
        "time": f"{frame.time:.1f} s",
        "speed": f"{float(info['speed']):.1f} m/s",
        "clearance": f"{float(info['clearance']):.1f} m",
        "expert": Mode(info["mode"]).name.lower(),
        "risk": ", ".join(risk.reasons) if risk.risky else "none",
        "planner": f"on, weight {info['blend_weight']:.2f}" if frame.triggered else "off",
        "shield": "–" if certificate is None else str(certificate.status),
    }
    return "\n".join(f"{name:10} {value.replace('_', ' ')}" for name, value in lines.items())
