"""The physics engine behind a small surface: the one file that imports pybullet."""

import math
import os
import string
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from irl_dal.arrays import Array, Colour
from irl_dal.envs.lighting import Illumination


@contextmanager
def _quiet() -> Iterator[None]:
    """Close stderr's file descriptor to what C code prints into it."""
    sys.stderr.flush()
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


with _quiet():  # it tells its build time on stderr
    import pybullet


# Longest integration step [s]: over random admissible commands the yaw rate is within 0.006 rad/s
# RMS of the bicycle's; Bullet's usual 1/240 s with 50 iterations: 0.004 for six times the cost
MAX_PHYSICS_STEP = 1.0 / 80.0
# Share of a step by which a duration may exceed whole steps: the error of a division
ROUNDING = 1e-9
# Of Bullet's constraint solver: with ten, the wheels stay 0.1 m/s below their set-point
SOLVER_ITERATIONS = 20
GRASS: Colour = (0.24, 0.42, 0.18)  # Of the meadow around everything
GRAVITY = 9.81  # [m/s^2]
UP = (0.0, 0.0, 1.0)
CLIPPING = (0.3, 90.0)  # Nearest and farthest distance that the camera sees [m]


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Pinhole camera: where it is, where it looks, how wide it sees."""

    eye: Sequence[float]  # Position (3,) [m]
    target: Sequence[float]  # Point (3,) in the middle of the image [m]
    field_of_view: float  # Vertical opening angle [deg]
    width: int  # Image width [px]
    height: int  # Image height [px]

    def sees_ground(self) -> NDArray[np.bool_]:
        """Which image rows (height,) look below the horizon."""
        sight = np.subtract(self.target, self.eye)
        slope = float(sight[2]) / float(np.hypot(sight[0], sight[1]))
        half = 0.5 * self.height
        focal = half / np.tan(np.radians(0.5 * self.field_of_view))
        return np.asarray(np.arange(self.height) + 0.5 - half > focal * slope)


class _Lent:
    """Rows of three numbers for pybullet, the same objects each time.

    `createVisualShape` takes two references to a mesh's lists, and to each list in them, and never
    gives them back: new lists would stay in memory for good (250 kB for each road).
    """

    def __init__(self) -> None:
        self._pool: list[list[float]] = []
        self._lent: list[list[float]] = []

    def rows(self, values: Array) -> list[list[float]]:
        """The rows of `values` (n, 3), until the next call."""
        while len(self._pool) < len(values):
            self._pool.append([0.0, 0.0, 0.0])
        for row, numbers in zip(self._pool, values.tolist(), strict=False):
            row[:] = numbers
        self._lent[:] = self._pool[: len(values)]
        return self._lent


class _Client:
    """Pybullet's constants, and its functions with `physicsClientId` given."""

    def __init__(self) -> None:
        self.id = pybullet.connect(pybullet.DIRECT)

    def __getattr__(self, name: str) -> Any:
        value = getattr(pybullet, name)
        return partial(value, physicsClientId=self.id) if callable(value) else value


class World:
    """One Bullet world in DIRECT mode; several live side by side in a process."""

    def __init__(self) -> None:
        self.bullet = _Client()
        self.is_open = True
        self._vertices, self._normals = _Lent(), _Lent()
        self._indices: list[int] = []

    def clear(self) -> None:
        """Remove every body and start again with gravity and flat, invisible ground."""
        self.bullet.resetSimulation()
        self.bullet.setGravity(0.0, 0.0, -GRAVITY)
        # The motors' impulses are reckoned with the step that holds when they are set.
        self.bullet.setPhysicsEngineParameter(
            fixedTimeStep=MAX_PHYSICS_STEP,
            deterministicOverlappingPairs=1,
            numSolverIterations=SOLVER_ITERATIONS,
        )
        plane = self.bullet.createCollisionShape(pybullet.GEOM_PLANE)
        # Without a visual shape of its own the engine would draw the plane.
        speck = self.bullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=[0.01] * 3, visualFramePosition=[0.0, 0.0, -50.0]
        )
        floor = self.bullet.createMultiBody(0.0, plane, speck)
        self.bullet.changeDynamics(floor, -1, lateralFriction=1.0)

    def __reduce__(self) -> NoReturn:
        """Refuse copies and pickles: the engine's state is not Python's."""
        raise TypeError(
            "A physics world can be neither copied nor pickled. Copy its `CityEnv`, which drives "
            "its episode again."
        )

    def close(self) -> None:
        """Leave the engine; calling it twice is harmless."""
        if self.is_open:
            self.bullet.disconnect()
            self.is_open = False

    def step(self, duration: float) -> None:
        """Advance the physics by exactly `duration` [s], in the fewest equal steps."""
        count = max(1, math.ceil(duration / MAX_PHYSICS_STEP - ROUNDING))
        self.bullet.setPhysicsEngineParameter(fixedTimeStep=duration / count)
        for _ in range(count):
            self.bullet.stepSimulation()

    def box(self, size: Sequence[float], colour: Colour, *, solid: bool = True) -> int:
        """Add a static box of edge lengths `size` (3,) [m], to be placed with `move`."""
        half = [0.5 * edge for edge in size]
        look = {"halfExtents": half, "rgbaColor": [*colour, 1.0]}
        visual = self.bullet.createVisualShape(pybullet.GEOM_BOX, **look)
        return self._static(visual, solid, pybullet.GEOM_BOX, halfExtents=half)

    def cylinder(self, radius: float, height: float, colour: Colour, *, solid: bool = True) -> int:
        """Add a static upright cylinder [m], drawn with eight sides, to be placed with `move`."""
        vertices, normals, triangles = _prism(radius, height)
        visual = self._shape(vertices, triangles, normals, colour)
        return self._static(visual, solid, pybullet.GEOM_CYLINDER, radius=radius, height=height)

    def _static(self, visual: int, solid: bool, kind: int, **size: Any) -> int:
        shape = self.bullet.createCollisionShape(kind, **size) if solid else -1
        return int(self.bullet.createMultiBody(0.0, shape, visual))

    def mesh(self, vertices: Array, triangles: NDArray[np.int64], colour: Colour) -> int:
        """Add a flat, purely visual mesh: `vertices` (n, 3) [m], `triangles` (m, 3)."""
        visual = self._shape(vertices, triangles, np.tile(UP, (len(vertices), 1)), colour)
        return int(self.bullet.createMultiBody(0.0, -1, visual))

    def _shape(
        self, vertices: Array, triangles: NDArray[np.int64], normals: Array, colour: Colour
    ) -> int:
        self._indices[:] = triangles.ravel().tolist()
        return int(
            self.bullet.createVisualShape(
                pybullet.GEOM_MESH,
                vertices=self._vertices.rows(vertices),
                indices=self._indices,
                normals=self._normals.rows(normals),
                rgbaColor=[*colour, 1.0],
            )
        )

    def car(self, **dimensions: float) -> int:
        """Load the ego vehicle's URDF with values [m] for the names in it."""
        text = (resources.files("irl_dal.envs") / "car.urdf").read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "car.urdf"
            path.write_text(string.Template(text).substitute(dimensions), encoding="utf-8")
            return int(self.bullet.loadURDF(str(path), flags=pybullet.URDF_USE_INERTIA_FROM_FILE))

    def remove(self, body: int) -> None:
        """Take a body out of the world."""
        self.bullet.removeBody(body)

    def move(self, body: int, position: Sequence[float], yaw: float) -> None:
        """Put a body at `position` (3,) [m], upright, turned by `yaw` [rad]."""
        half = 0.5 * yaw
        self.bullet.resetBasePositionAndOrientation(
            body, position, [0.0, 0.0, float(np.sin(half)), float(np.cos(half))]
        )

    def rays(self, origin: Array, ends: Array) -> Array:
        """Share of each ray's length that is free: `origin` (3,), `ends` (n, 3) → (n,)."""
        hits = self.bullet.rayTestBatch([origin.tolist()] * len(ends), ends.tolist())
        return np.array([hit[2] for hit in hits])

    def render(self, camera: CameraPose, light: Illumination) -> NDArray[np.uint8]:
        """Draw the scene on the CPU: (height, width, 3) uint8; where nothing is, sky and grass.

        The meadow is no body: so many pixels would cost a third of the picture.
        """
        view = pybullet.computeViewMatrix(camera.eye, camera.target, UP)
        shape, aspect = (camera.height, camera.width), camera.width / camera.height
        projection = pybullet.computeProjectionMatrixFOV(camera.field_of_view, aspect, *CLIPPING)
        _, _, rgba, depth, _ = self.bullet.getCameraImage(
            camera.width,
            camera.height,
            view,
            projection,
            lightDirection=light.direction,
            lightColor=light.colour,
            lightAmbientCoeff=light.ambient,
            lightDiffuseCoeff=light.diffuse,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
        )
        image = np.asarray(rgba, dtype=np.uint8).reshape(*shape, 4)
        rows = camera.sees_ground()[:, None, None]
        background = np.zeros((camera.height, 1, 4), dtype=np.uint8)
        background[..., :3] = np.where(rows, light.on_ground(GRASS), 255.0 * np.array(light.sky))
        # A pixel as one number: seven times as fast as three channels at once.
        empty = np.reshape(depth, shape) >= 1.0
        drawn = np.where(empty, background.view(np.uint32)[..., 0], image.view(np.uint32)[..., 0])
        return drawn.view(np.uint8).reshape(*shape, 4)[..., :3]


def _prism(radius: float, height: float, sides: int = 8) -> tuple[Array, Array, NDArray[np.int64]]:
    """Side faces and lid of an upright prism: vertices, normals (n, 3) and triangles (m, 3)."""
    angle, side = 2.0 * np.pi * np.arange(sides + 1) / sides, np.arange(sides)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    middle = 0.5 * (angle[:-1] + angle[1:])
    lower, upper = (np.insert(rim, 2, z * height, axis=1) for z in (-0.5, 0.5))
    corners = np.stack([lower[:-1], lower[1:], upper[:-1], upper[1:]], axis=1).reshape(-1, 3)
    outward = np.stack([np.cos(middle), np.sin(middle), np.zeros(sides)], axis=1)
    faces = 4 * side[:, None, None] + [[0, 1, 2], [1, 3, 2]]
    lid = len(corners) + side[1:-1, None] * [0, 1, 1] + [0, 0, 1]
    return (
        np.concatenate([corners, upper[:-1]]),
        np.concatenate([outward.repeat(4, axis=0), np.tile(UP, (sides, 1))]),
        np.concatenate([faces.reshape(-1, 3), lid]),
    )
