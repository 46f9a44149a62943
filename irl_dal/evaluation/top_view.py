"""The road from above, as the car sees itself: forward is up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from irl_dal.envs import Scene
from irl_dal.envs.road import HALF_WIDTH, LANE_WIDTH
from irl_dal.envs.vehicle import FRONT_BUMPER, LENGTH, REAR_OVERHANG, WIDTH, VehicleState

__all__ = ["PALETTE", "TopView"]

Array = NDArray[np.float64]

PALETTE = {
    "ground": "#dfe6d8",
    "road": "#8f959c",
    "edge": "#ffffff",
    "centre": "#f2b705",
    "obstacle": "#33404f",
    "barrel": "#d8611a",
    "ego": "#1f77b4",
    "plan": "#d81b60",
    "car": "#b71c1c",
    "lidar": "#00838f",
    "trail": "#0b3c5d",
    "muted": "#9aa0a6",
}
"""Colours of the pictures; `ego` is for curves, the car itself is red as in the chase view."""

AHEAD, BEHIND, ASIDE = 42.0, 12.0, 20.0
"""What the view covers around the rear axle [m]."""

SPACING = 1.0
"""Between two points of a drawn road line [m]."""


@dataclass(slots=True)
class TopView:
    """Draws one scene after the other into the same axes.

    Attributes:
        axes: Where to draw.
        lidar_range: Reading of a beam that hits nothing [m].
    """

    axes: Axes
    lidar_range: float

    def draw(self, scene: Scene, trail: Array, plan: Array | None) -> None:
        """Replace what is drawn.

        Args:
            scene: The moment.
            trail: Positions driven so far (T, 2) [m], world coordinates.
            plan: Positions of the plan (H + 1, 2) [m], world coordinates; None without one.
        """
        axes = self.axes
        axes.cla()
        axes.set(xlim=(-ASIDE, ASIDE), ylim=(-BEHIND, AHEAD), aspect="equal")
        axes.set(xlabel="to the right [m]", ylabel="ahead [m]")
        axes.set_facecolor(PALETTE["ground"])
        self._road(scene)
        self._obstacles(scene)
        self._scan(scene)
        self._line(scene.vehicle, trail, "trail", linewidth=1.2, linestyle=":")
        self._box(scene.vehicle, _ego_corners(scene.vehicle), "car")
        if plan is not None:
            self._line(scene.vehicle, plan, "plan", linewidth=2.5, label="plan")

    def _road(self, scene: Scene) -> None:
        road, vehicle = scene.road, scene.vehicle
        here = road.locate(vehicle.x, vehicle.y).s
        start = max(float(road.s[0]), here - BEHIND - ASIDE)
        stop = min(float(road.s[-1]), here + AHEAD + ASIDE)
        edges = [road.line(start, stop, d, SPACING) for d in (-HALF_WIDTH, HALF_WIDTH)]
        self._box(vehicle, np.concatenate([edges[0], edges[1][::-1]]), "road")
        for edge in edges:
            self._line(vehicle, edge, "edge", linewidth=1.5)
        self._line(vehicle, road.line(start, stop, 0.0, SPACING), "centre", linewidth=2.0)
        for d in (-LANE_WIDTH, LANE_WIDTH):
            line = road.line(start, stop, d, SPACING)
            self._line(vehicle, line, "edge", linewidth=1.0, linestyle=(0, (5, 5)))

    def _obstacles(self, scene: Scene) -> None:
        for obstacle in scene.obstacles:
            x, y, yaw = scene.road.pose(obstacle.s, obstacle.d)
            length, width, _ = obstacle.size
            corners = _corners(x, y, yaw, -0.5 * length, 0.5 * length, width)
            self._box(scene.vehicle, corners, "barrel" if obstacle.kind == "barrel" else "obstacle")

    def _scan(self, scene: Scene) -> None:
        hit = scene.scan < self.lidar_range
        ahead = FRONT_BUMPER + scene.scan * np.cos(scene.angles)
        left = scene.scan * np.sin(scene.angles)
        self.axes.plot(-left[hit], ahead[hit], ".", color=PALETTE["lidar"], ms=2.5, zorder=5)

    def _line(self, vehicle: VehicleState, points: Array, colour: str, **style: object) -> None:
        right, ahead = _in_view(vehicle, points)
        self.axes.plot(right, ahead, color=PALETTE[colour], solid_capstyle="butt", **style)

    def _box(self, vehicle: VehicleState, corners: Array, colour: str) -> None:
        shape = np.stack(_in_view(vehicle, corners), axis=1)
        order = 1 if colour == "road" else 4
        self.axes.add_patch(Polygon(shape, facecolor=PALETTE[colour], zorder=order))


def _in_view(vehicle: VehicleState, points: Array) -> tuple[Array, Array]:
    """World positions (n, 2) as metres to the right of and ahead of the rear axle."""
    offset = points - (vehicle.x, vehicle.y)
    cos, sin = np.cos(vehicle.yaw), np.sin(vehicle.yaw)
    return sin * offset[:, 0] - cos * offset[:, 1], cos * offset[:, 0] + sin * offset[:, 1]


def _ego_corners(vehicle: VehicleState) -> Array:
    front = LENGTH - REAR_OVERHANG
    return _corners(vehicle.x, vehicle.y, vehicle.yaw, -REAR_OVERHANG, front, WIDTH)


def _corners(x: float, y: float, yaw: float, rear: float, front: float, width: float) -> Array:
    """Corners (4, 2) of a rectangle around a reference point, in world coordinates."""
    along = np.array([rear, front, front, rear])
    left = 0.5 * width * np.array([1.0, 1.0, -1.0, -1.0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([x + cos * along - sin * left, y + sin * along + cos * left], axis=1)
