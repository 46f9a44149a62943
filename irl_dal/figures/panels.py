"""The film's plots of the commands and its words about trigger, planner and shield."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from numpy.typing import NDArray

from expert import Mode
from irl_dal.figures.style import PALETTE

__all__ = ["CommandPlot", "FilmFrame", "StatusPanel"]

Array = NDArray[np.float64]

WINDOW = 10.0
"""Past that the plots show [s]."""


@dataclass(frozen=True, slots=True)
class FilmFrame:
    """What the film remembers of a step.

    Attributes:
        time: Since the start of the drive [s].
        pose: True x, y, yaw [m, m, rad].
        nominal: Command before the shield (2,) [rad, m/s].
        executed: Command after it (2,) [rad, m/s].
        triggered: Whether the planner was used.
    """

    time: float
    pose: Array
    nominal: Array
    executed: Array
    triggered: bool

    @classmethod
    def of(cls, time: float, info: Mapping[str, Any]) -> FilmFrame:
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
    """One component of the commands over the last seconds, between its bounds.

    Args:
        axes: Where to draw.
        component: 0 steering, 1 speed.
        scale: From the command's unit to the plot's.
        bounds: Lowest and highest command, in the plot's unit.
        title: Quantity and unit.
    """

    def __init__(
        self,
        axes: Axes,
        component: int,
        scale: float,
        bounds: tuple[float, float],
        title: str,
    ) -> None:
        self._axes = axes
        self._component = component
        self._scale = scale
        margin = 0.08 * (bounds[1] - bounds[0])
        self._low, self._high = bounds[0] - margin, bounds[1] + margin
        axes.set(ylim=(self._low, self._high), xlim=(-WINDOW, 0.0), xlabel="time before now [s]")
        axes.set_title(title, loc="left", fontsize=11)
        for bound in bounds:
            axes.axhline(bound, color="black", linewidth=0.8, linestyle="--")
        (self._nominal,) = axes.plot([], [], color=PALETTE["muted"], linewidth=1.2, animated=True)
        (self._executed,) = axes.plot([], [], color=PALETTE["ego"], linewidth=1.8, animated=True)
        self._tint = axes.fill_between([], [], [])

    @property
    def artists(self) -> list[Artist]:
        """What has to be drawn, from the back to the front."""
        return [self._tint, self._nominal, self._executed]

    def explain(self) -> None:
        """Add a legend."""
        self._nominal.set_label("before the shield")
        self._executed.set_label("executed")
        on = Patch(color=PALETTE["plan"], alpha=0.15, label="planner on")
        handles = [self._nominal, self._executed, on]
        self._axes.legend(handles=handles, loc="lower left", fontsize=7, framealpha=0.8)

    def update(self, frames: Sequence[FilmFrame]) -> None:
        """Show the newest frames."""
        time = np.array([frame.time for frame in frames]) - frames[-1].time
        for line, commands in (
            (self._nominal, [frame.nominal for frame in frames]),
            (self._executed, [frame.executed for frame in frames]),
        ):
            line.set_data(time, self._scale * np.array(commands)[:, self._component])
        self._tint.remove()
        on = [frame.triggered for frame in frames]
        self._tint = self._axes.fill_between(
            time, self._low, self._high, where=on, color=PALETTE["plan"], alpha=0.15, linewidth=0.0,
            animated=True,
        )  # fmt: skip


class StatusPanel:
    """A small table of what is going on.

    Args:
        axes: Where to write.
    """

    ROWS = ("time", "speed", "clearance", "expert's mode", "risk", "planner", "shield")

    def __init__(self, axes: Axes) -> None:
        axes.set_axis_off()
        self._values = {}
        for row, name in enumerate(self.ROWS):
            height = 1.0 - (row + 0.5) / len(self.ROWS)
            axes.text(0.0, height, name, fontsize=9, va="center", color=PALETTE["text"])
            self._values[name] = axes.text(
                0.36, height, "", fontsize=9, va="center", weight="bold", animated=True
            )

    @property
    def artists(self) -> list[Artist]:
        """What has to be drawn."""
        return list(self._values.values())

    def update(self, frame: FilmFrame, info: Mapping[str, Any]) -> None:
        """Write down the newest frame."""
        risk, certificate = info["risk"], info.get("certificate")
        weight = info.get("blend_weight", 0.0)
        texts = {
            "time": f"{frame.time:.1f} s",
            "speed": f"{float(info['speed']):.1f} m/s",
            "clearance": f"{float(info['clearance']):.1f} m",
            "expert's mode": Mode(info["mode"]).name.replace("_", " ").lower(),
            "risk": ", ".join(risk.reasons).replace("_", " ") if risk.risky else "none",
            "planner": f"on, weight {weight:.2f}" if frame.triggered else "off",
            "shield": "–" if certificate is None else str(certificate.status),
        }
        hot = {"risk": risk.risky, "planner": frame.triggered}
        for name, text in texts.items():
            colour = PALETTE["plan"] if hot.get(name, False) else "black"
            self._values[name].set(text=text, color=colour)
