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
from shield import ActuatorLimits

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
        component: 0 steering, shown in degrees; 1 speed.
        limits: Give the bounds and the control step.
    """

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
        (self._nominal,) = axes.plot(
            [], [], color=PALETTE["muted"], lw=1.2, animated=True, label="before the shield"
        )
        (self._executed,) = axes.plot(
            [], [], color=PALETTE["ego"], lw=1.8, animated=True, label="executed"
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


class StatusPanel:
    """What is going on, in seven lines.

    Args:
        axes: Where to write.
    """

    def __init__(self, axes: Axes) -> None:
        axes.set_axis_off()
        self._text = axes.text(
            0.0, 1.0, "", fontsize=9, va="top", linespacing=1.5, family="monospace", animated=True
        )

    @property
    def artists(self) -> list[Artist]:
        """What has to be drawn."""
        return [self._text]

    def update(self, frame: FilmFrame, info: Mapping[str, Any]) -> None:
        """Write down the newest frame, in the planner's colour where the state is risky."""
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
        text = "\n".join(f"{name:10} {value.replace('_', ' ')}" for name, value in lines.items())
        hot = risk.risky or frame.triggered
        self._text.set(text=text, color=PALETTE["plan"] if hot else "black")
