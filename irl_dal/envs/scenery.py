"""What the camera sees of the road: asphalt, lines and houses, only around the car.

Triangles are what the software renderer costs, so the road is drawn in pieces that come and go
with the car.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irl_dal.envs.road import HALF_WIDTH, LANE_WIDTH, Road
from irl_dal.envs.world import Colour, World

Array = NDArray[np.float64]

PIECE = 20.0
"""Length of road drawn as one piece [m]."""

BEHIND, AHEAD = 15.0, 75.0
"""How far around the car the road is drawn [m]."""

DASH, GAP = 3.0, 4.5
"""Dashed lane line: painted and unpainted length [m]."""

LINE_WIDTH, CENTRE_WIDTH = 0.15, 0.24
"""White lines and the yellow centre line [m]."""

ASPHALT: Colour = (0.27, 0.27, 0.29)
GRASS: Colour = (0.24, 0.42, 0.18)
KERB: Colour = (0.52, 0.52, 0.50)
WHITE: Colour = (0.92, 0.92, 0.92)
YELLOW: Colour = (0.95, 0.75, 0.05)


def ribbon(left: Array, right: Array, height: float) -> tuple[Array, NDArray[np.int64]]:
    """Flat strip between two lines (n, 2): vertices (2n, 3) and triangles (2n-2, 3)."""
    n = len(left)
    vertices = np.empty((2 * n, 3))
    vertices[0::2, :2], vertices[1::2, :2] = left, right
    vertices[:, 2] = height
    i = 2 * np.arange(n - 1)[:, None]
    triangles = np.concatenate([i + [0, 1, 2], i + [1, 3, 2]])
    return vertices, triangles


class Scenery:
    """Keeps the pieces of road around the car in the world.

    Args:
        world: Where to draw.
        road: What to draw.
        rng: Source of the houses' places, sizes and colours.
    """

    def __init__(self, world: World, road: Road, rng: np.random.Generator) -> None:
        self._world = world
        self._road = road
        self._pieces: dict[int, list[int]] = {}
        self._plant_houses(rng)

    def show_around(self, s: float) -> None:
        """Draw the pieces from 15 m behind `s` [m] to 75 m ahead and take the others away."""
        first = int(np.floor((s - BEHIND) / PIECE))
        last = int(np.floor((s + AHEAD) / PIECE))
        for piece in [p for p in self._pieces if not first <= p <= last]:
            for body in self._pieces.pop(piece):
                self._world.remove(body)
        for piece in range(first, last + 1):
            if piece not in self._pieces:
                self._pieces[piece] = self._draw(piece)

    def _draw(self, piece: int) -> list[int]:
        start = max(piece * PIECE, float(self._road.s[0]))
        stop = min((piece + 1) * PIECE, float(self._road.s[-1]))
        if stop - start < 1.0:
            return []
        edge = HALF_WIDTH - 0.15
        solid = [self._strip(start, stop, d, LINE_WIDTH, 0.04) for d in (-edge, edge)]
        period = DASH + GAP
        dashes = np.arange(np.ceil(start / period) * period, stop, period)
        broken = [
            self._strip(s, min(s + DASH, float(self._road.s[-1])), d, LINE_WIDTH, 0.04)
            for s in dashes
            for d in (-LANE_WIDTH, LANE_WIDTH)
        ]
        return [
            self._mesh([self._strip(start, stop, 0.0, 2.0 * HALF_WIDTH + 0.8, 0.0)], KERB),
            self._mesh([self._strip(start, stop, 0.0, 2.0 * HALF_WIDTH, 0.02)], ASPHALT),
            self._mesh([self._strip(start, stop, 0.0, CENTRE_WIDTH, 0.04)], YELLOW),
            self._mesh(solid + broken, WHITE),
        ]

    def _strip(
        self, start: float, stop: float, d: float, width: float, height: float
    ) -> tuple[Array, NDArray[np.int64]]:
        left = self._road.line(start, stop, d + 0.5 * width, 4.0)
        right = self._road.line(start, stop, d - 0.5 * width, 4.0)
        return ribbon(left, right, height)

    def _mesh(self, strips: list[tuple[Array, NDArray[np.int64]]], colour: Colour) -> int:
        offsets = np.cumsum([0] + [len(v) for v, _ in strips[:-1]])
        vertices = np.concatenate([v for v, _ in strips])
        triangles = np.concatenate([t + o for (_, t), o in zip(strips, offsets, strict=True)])
        return self._world.mesh(vertices, triangles, colour)

    def _plant_houses(self, rng: np.random.Generator) -> None:
        """Solid boxes on both sides, at least 6 m from the edge of the road."""
        s = 0.0
        while s < self._road.length + 40.0:
            s += float(rng.uniform(18.0, 40.0))
            side = float(rng.choice([-1.0, 1.0]))
            depth, width, height = rng.uniform((6.0, 8.0, 4.0), (10.0, 16.0, 10.0))
            d = side * (HALF_WIDTH + 6.0 + 0.5 * depth + float(rng.uniform(0.0, 6.0)))
            x, y, yaw = self._road.pose(s, d)
            away = np.hypot(*(self._road.points - (x, y)).T).min()
            shade = rng.uniform((0.45, 0.35, 0.30), (0.75, 0.65, 0.60))
            if away < HALF_WIDTH + 4.0 + 0.5 * float(np.hypot(depth, width)):
                continue
            colour = (float(shade[0]), float(shade[1]), float(shade[2]))
            house = self._world.box((width, depth, height), colour)
            self._world.move(house, (x, y, 0.5 * float(height)), yaw)
