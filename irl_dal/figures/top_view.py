"""The road from above, as the car sees itself: forward is up."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D

from irl_dal.envs import Scene
from irl_dal.envs.road import HALF_WIDTH, LANE_WIDTH
from irl_dal.envs.vehicle import VehicleState
from irl_dal.figures.style import PALETTE, Array

AHEAD, BEHIND, ASIDE = 42.0, 12.0, 20.0  # what the view covers around the rear axle [m]
SPACING = 1.0  # between two points of a drawn road line [m]
LINES = {
    -HALF_WIDTH: ("edge", 1.5, "-"),
    HALF_WIDTH: ("edge", 1.5, "-"),
    0.0: ("centre", 2.0, "-"),
    -LANE_WIDTH: ("edge", 1.0, (0, (5, 5))),
    LANE_WIDTH: ("edge", 1.0, (0, (5, 5))),
}
"""Offset of each road line [m]: colour, width, style."""


class TopView:
    """Everything that moves in the view; a LiDAR beam that hits nothing reads `lidar_range` [m]."""

    def __init__(self, axes: Axes, lidar_range: float) -> None:
        self._lidar_range = lidar_range
        axes.set(xlim=(-ASIDE, ASIDE), ylim=(-BEHIND, AHEAD), aspect="equal")
        axes.set(xlabel="to the right [m]", ylabel="ahead [m]")
        axes.set_facecolor(PALETTE["ground"])
        names = ("road", "obstacle", "barrel", "car")
        self._shapes = {
            name: PolyCollection([], facecolor=PALETTE[name], animated=True) for name in names
        }
        for shapes in self._shapes.values():
            axes.add_collection(shapes)
        self._lines = {d: _line(axes, *style) for d, style in LINES.items()}
        self._trail = _line(axes, "trail", 1.2, ":")
        self._plan = _line(axes, "plan", 2.5, "-")
        self._scan = _line(axes, "lidar", 0.0, "none")
        self._scan.set(marker=".", markersize=3.0)

    @property
    def artists(self) -> list[Artist]:
        """What has to be drawn, from the ground up."""
        shapes = self._shapes
        above = [shapes["obstacle"], shapes["barrel"], self._scan, self._trail, shapes["car"]]
        return [shapes["road"], *self._lines.values(), *above, self._plan]

    def update(self, scene: Scene, trail: Array, plan: Array | None) -> None:
        """Move everything to where it is now.

        `trail` holds the positions driven so far (T, 2) and `plan` those of the plan (H + 1, 2),
        None without one, in world coordinates [m].
        """
        vehicle = scene.vehicle
        self._move_road(scene)
        geometry = scene.geometry
        rear, front = -geometry.rear_overhang, geometry.front_bumper
        own = _corners(vehicle.x, vehicle.y, vehicle.yaw, rear, front, geometry.width)
        outlines: dict[str, list[Array]] = {"barrel": [], "obstacle": [], "car": [own]}
        for obstacle in scene.obstacles:
            x, y, yaw = scene.road.pose(obstacle.s, obstacle.d)
            length, width, _ = obstacle.size
            corners = _corners(x, y, yaw, -0.5 * length, 0.5 * length, width)
            kind = "barrel" if obstacle.kind == "barrel" else "obstacle"
            outlines[kind].append(corners)
        for kind, shapes in outlines.items():
            self._shapes[kind].set_verts([_in_view(vehicle, shape) for shape in shapes])
        self._trail.set_data(*_in_view(vehicle, trail).T)
        self._plan.set_data(*_in_view(vehicle, np.empty((0, 2)) if plan is None else plan).T)
        hit = scene.scan < self._lidar_range
        reach, bearing = scene.scan[hit], scene.angles[hit]
        self._scan.set_data(
            -reach * np.sin(bearing), scene.geometry.front_bumper + reach * np.cos(bearing)
        )

    def _move_road(self, scene: Scene) -> None:
        road, vehicle = scene.road, scene.vehicle
        here = road.locate(vehicle.x, vehicle.y).s
        start = max(float(road.s[0]), here - BEHIND - ASIDE)
        stop = min(float(road.s[-1]), here + AHEAD + ASIDE)
        drawn = {d: _in_view(vehicle, road.line(start, stop, d, SPACING)) for d in self._lines}
        for d, line in self._lines.items():
            line.set_data(*drawn[d].T)
        surface = np.concatenate([drawn[-HALF_WIDTH], drawn[HALF_WIDTH][::-1]])
        self._shapes["road"].set_verts([surface])


def _line(axes: Axes, colour: str, width: float, style: object) -> Line2D:
    (line,) = axes.plot(
        [], [], color=PALETTE[colour], linewidth=width, linestyle=style, animated=True
    )
    return line


def _in_view(vehicle: VehicleState, points: Array) -> Array:
    """World positions (n, 2) as metres to the right of and ahead of the rear axle (n, 2)."""
    offset = points - (vehicle.x, vehicle.y)
    cos, sin = np.cos(vehicle.yaw), np.sin(vehicle.yaw)
    return np.asarray(offset @ np.array([[sin, cos], [-cos, sin]]))


def _corners(x: float, y: float, yaw: float, rear: float, front: float, width: float) -> Array:
    """Corners (4, 2) of a rectangle around a reference point, in world coordinates."""
    along = np.array([rear, front, front, rear])
    left = 0.5 * width * np.array([1.0, 1.0, -1.0, -1.0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([x + cos * along - sin * left, y + sin * along + cos * left], axis=1)
