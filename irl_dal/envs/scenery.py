"""What stands beside the road and what is painted on it, only around the car.

Triangles and bodies are what the software renderer costs, so the road is drawn in pieces that come
and go with the car, with the houses and trees beside them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irl_dal.arrays import Array, Colour
from irl_dal.envs.road import HALF_WIDTH, LANE_WIDTH, Road, stations
from irl_dal.envs.world import World

Strip = tuple[Array, NDArray[np.int64]]
Size = tuple[float, float, float]

STEP = 3.0  # Edge length of the road's triangles along it [m]
PIECE = 30.0  # Length of road drawn as one piece [m]
BEHIND, AHEAD = 15.0, 75.0  # How far around the car the road is drawn [m]
DASH, GAP = 3.0, 4.5  # Dashed lane line: painted and unpainted length [m]
LINE_WIDTH, CENTRE_WIDTH = 0.20, 0.40  # White lines; yellow one, as a double line with its gap [m]
EDGE_LINE = HALF_WIDTH - 0.15  # Middle of the solid white line at the edge [m]
GUTTER = 0.4  # Width of the kerb [m]
# Height of the lines above the ground [m]: the renderer's depth buffer needs the distance
PAINT = 0.04
SURFACE = 0.02  # Height of asphalt and kerb above the ground [m], for the same reason
TWO_LANES = 1.8 * LANE_WIDTH  # Width of the other direction [m] from which it has a dashed line
BEYOND_GOAL = 60.0  # Houses and trees stand up to here behind the goal [m]
# Distance along the road between two of them, and what is added to their distance from it [m]
SPREAD, SETBACK = (8.0, 22.0), 6.0
HOUSES = 0.4  # Share of houses; the others are trees
HOUSE_ROOM, TREE_ROOM = 6.0, 2.0  # Least distance between the edge and a wall or a crown [m]
SMALLEST_HOUSE, LARGEST_HOUSE = (8.0, 6.0, 4.0), (16.0, 10.0, 10.0)  # Width, depth, height [m]
# Radius of the trunk, radius of the crown, height [m]
SMALLEST_TREE, LARGEST_TREE = (0.15, 1.0, 3.5), (0.30, 2.2, 7.0)
DARKEST_WALL, BRIGHTEST_WALL = (0.45, 0.35, 0.30), (0.75, 0.65, 0.60)
GREENS = (0.26, 0.42)
BARK, ASPHALT, KERB = (0.30, 0.22, 0.15), (0.27, 0.27, 0.29), (0.52, 0.52, 0.50)
WHITE, YELLOW = (0.92, 0.92, 0.92), (0.95, 0.75, 0.05)


def ribbon(left: Array, right: Array, height: float) -> Strip:
    """Flat strip between two lines (n, 2): vertices (2n, 3) and triangles (2n-2, 3)."""
    n = len(left)
    vertices = np.empty((2 * n, 3))
    vertices[0::2, :2], vertices[1::2, :2] = left, right
    vertices[:, 2] = height
    i = 2 * np.arange(n - 1)[:, None]
    triangles = np.concatenate([i + [0, 1, 2], i + [1, 3, 2]])
    return vertices, triangles


@dataclass(frozen=True, slots=True)
class Plant:
    """A house or a tree."""

    x: float  # Position [m]
    y: float  # Position [m]
    yaw: float  # Direction of its walls [rad]
    # Width, depth, height of a house; trunk radius, crown radius, height of a tree [m]
    size: Size
    colour: Colour  # Of walls or crown
    tree: bool  # Which of the two it is


class Scenery:
    """Keeps the pieces of road around the car in the world, with the houses and trees beside."""

    def __init__(self, world: World, road: Road, rng: np.random.Generator) -> None:
        self._world = world
        self._road = road
        self._pieces: dict[int, list[int]] = {}
        self._shown: tuple[int, int] | None = None
        self._plants: dict[int, list[Plant]] = {}
        self._plan(rng)

    def show_around(self, s: float) -> None:
        """Draw the pieces from 15 m behind `s` [m] to 75 m ahead and take the others away."""
        first = int(np.floor((s - BEHIND) / PIECE))
        last = int(np.floor((s + AHEAD) / PIECE))
        if (first, last) == self._shown:
            return
        self._shown = (first, last)
        for piece in [p for p in self._pieces if not first <= p <= last]:
            for body in self._pieces.pop(piece):
                self._world.remove(body)
        for piece in [p for p in range(first, last + 1) if p not in self._pieces]:
            beside = [b for plant in self._plants.get(piece, ()) for b in self._build(plant)]
            self._pieces[piece] = self._draw(piece) + beside

    def _draw(self, piece: int) -> list[int]:
        road = self._road
        start = max(piece * PIECE, float(road.s[0]))
        stop = min((piece + 1) * PIECE, float(road.s[-1]))
        if stop - start < 1.0:
            return []
        period, end = DASH + GAP, float(road.s[-1])
        dashes = np.arange(np.ceil(start / period) * period, stop, period)
        offsets = [-LANE_WIDTH]
        if float(np.interp([start, stop], road.s, road.left_edge).min()) > TWO_LANES:
            offsets.append(LANE_WIDTH)
        places = [(s, min(s + DASH, end), d) for s in dashes for d in offsets]
        half, inset = 0.5 * LINE_WIDTH, HALF_WIDTH - EDGE_LINE
        dashed = [self._strip(a, b, d + half, d - half, PAINT) for a, b, d in places]
        # Offsets of the left-hand edge
        edge = np.interp(stations(start, stop, STEP), road.s, road.left_edge)
        edges = [
            self._strip(start, stop, -EDGE_LINE + half, -EDGE_LINE - half, PAINT),
            self._strip(start, stop, edge - (inset - half), edge - (inset + half), PAINT),
        ]
        kerbs = [
            self._strip(start, stop, -HALF_WIDTH, -HALF_WIDTH - GUTTER, SURFACE),
            self._strip(start, stop, edge + GUTTER, edge, SURFACE),
        ]
        middle = self._strip(start, stop, 0.5 * CENTRE_WIDTH, -0.5 * CENTRE_WIDTH, PAINT)
        return [
            self._mesh(edges + dashed, WHITE),
            self._mesh([middle], YELLOW),
            self._mesh([self._strip(start, stop, edge, -HALF_WIDTH, SURFACE)], ASPHALT),
            self._mesh(kerbs, KERB),
        ]

    def _strip(
        self, start: float, stop: float, left: float | Array, right: float | Array, height: float
    ) -> Strip:
        """Flat strip between the offsets `left` and `right` [m]."""
        edges = [self._road.line(start, stop, offset, STEP) for offset in (left, right)]
        return ribbon(edges[0], edges[1], height)

    def _mesh(self, strips: list[Strip], colour: Colour) -> int:
        offsets = np.cumsum([0] + [len(v) for v, _ in strips[:-1]])
        vertices = np.concatenate([v for v, _ in strips])
        triangles = np.concatenate([t + o for (_, t), o in zip(strips, offsets, strict=True)])
        return self._world.mesh(vertices, triangles, colour)

    def _plan(self, rng: np.random.Generator) -> None:
        """Choose houses at least 6 m and trees at least 3 m from the edge of the road."""
        s = 0.0
        while s < self._road.length + BEYOND_GOAL:
            s += float(rng.uniform(*SPREAD))
            tree = rng.random() >= HOUSES
            size, colour, room = _tree(rng) if tree else _house(rng)
            side = float(rng.choice([-1.0, 1.0]))
            left = float(np.interp(s, self._road.s, self._road.left_edge))
            edge = HALF_WIDTH if side < 0.0 else left
            d = side * (edge + room + float(rng.uniform(0.0, SETBACK)))
            x, y, yaw = self._road.pose(s, d)
            away = np.hypot(*(self._road.points - (x, y)).T).min()
            if away < min(abs(d) - 0.5, HALF_WIDTH + room):
                continue
            plant = Plant(x, y, yaw, size, colour, tree)
            self._plants.setdefault(int(np.floor(s / PIECE)), []).append(plant)

    def _build(self, plant: Plant) -> list[int]:
        width, depth, height = plant.size
        if plant.tree:
            trunk = self._world.cylinder(width, 0.4 * height, BARK)
            crown = self._world.cylinder(depth, 0.65 * height, plant.colour, solid=False)
            self._world.move(trunk, (plant.x, plant.y, 0.2 * height), plant.yaw)
            self._world.move(crown, (plant.x, plant.y, 0.65 * height), plant.yaw)
            return [trunk, crown]
        house = self._world.box(plant.size, plant.colour)
        self._world.move(house, (plant.x, plant.y, 0.5 * height), plant.yaw)
        return [house]


def _house(rng: np.random.Generator) -> tuple[Size, Colour, float]:
    """Size and colour of a house, and how far from the edge its middle has to be [m]."""
    width, depth, height = (float(v) for v in rng.uniform(SMALLEST_HOUSE, LARGEST_HOUSE))
    r, g, b = (float(v) for v in rng.uniform(DARKEST_WALL, BRIGHTEST_WALL))
    return (width, depth, height), (r, g, b), HOUSE_ROOM + 0.5 * depth


def _tree(rng: np.random.Generator) -> tuple[Size, Colour, float]:
    trunk, crown, height = (float(v) for v in rng.uniform(SMALLEST_TREE, LARGEST_TREE))
    green = float(rng.uniform(*GREENS))
    colour = (0.45 * green, green, 0.35 * green)
    return (trunk, crown, height), colour, TREE_ROOM + crown
