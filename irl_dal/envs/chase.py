"""A view from behind and above the car, for people."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from irl_dal.arrays import Array
from irl_dal.envs.lighting import Illumination
from irl_dal.envs.road import Road
from irl_dal.envs.traffic import Obstacle
from irl_dal.envs.vehicle import VehicleState
from irl_dal.envs.world import CameraPose, World
from shield import VehicleGeometry

Pen = ImageDraw.ImageDraw
Tint = tuple[int, int, int]
# Where the camera flies and how far in front of the car it looks [m]
BEHIND, ABOVE, AHEAD = 10.0, 5.0, 12.0
FIELD_OF_VIEW = 50.0  # [deg]
WIDTH, HEIGHT = 640, 360  # [px]
BEAM_HEIGHT = 0.6  # At which the LiDAR's rays are drawn [m]
EVERY = 3  # One ray in so many is drawn
CALM, RISKY = (90, 200, 140), (235, 70, 60)  # Colours of the rays and of the badge


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that a view draws, in world coordinates."""

    road: Road  # The road
    obstacles: tuple[Obstacle, ...]  # Everything on it
    vehicle: VehicleState  # The ego car
    scan: Array  # Noise-free LiDAR ranges (beams,) [m]
    angles: Array  # Bearings of the beams (beams,) [rad]
    geometry: VehicleGeometry  # Outline of the ego car


def chase_view(
    world: World, scene: Scene, light: Illumination, overlay: tuple[bool, str]
) -> NDArray[np.uint8]:
    """Image (height, width, 3) uint8 of the car, the road ahead and the LiDAR's rays.

    `overlay` is what the control loop adds: the trigger's verdict and a line of text.
    """
    (risky, text), state = overlay, scene.vehicle
    ahead = np.array([np.cos(state.yaw), np.sin(state.yaw)])
    here = np.array([state.x, state.y])
    eye, aim = here - BEHIND * ahead, here + AHEAD * ahead
    camera = CameraPose((*eye.tolist(), ABOVE), (*aim.tolist(), 0.5), FIELD_OF_VIEW, WIDTH, HEIGHT)
    picture = Image.fromarray(world.render(camera, light)).convert("RGBA")
    glass = Image.new("RGBA", picture.size)
    pen = ImageDraw.Draw(glass)
    colour = RISKY if risky else CALM
    _draw_rays(pen, scene, colour)
    _draw_badge(pen, text, state.speed, colour)
    return np.array(Image.alpha_composite(picture, glass).convert("RGB"))


def _draw_rays(pen: Pen, scene: Scene, colour: Tint) -> None:
    """Rays that hit something, with a dot where they end."""
    scan, angles, mount = scene.scan, scene.angles, scene.geometry.front_bumper
    farthest = float(scan.max(initial=0.0))
    hit = scan < max(farthest, 1.0) - 0.5
    hit[np.arange(len(hit)) % EVERY != 0] = False
    origin = _project(np.array([[mount, 0.0, BEAM_HEIGHT]]))[0]
    x, y = mount + scan * np.cos(angles), scan * np.sin(angles)
    ends = np.stack([x, y, np.full(len(scan), BEAM_HEIGHT)], axis=1)
    for x, y in _project(ends[hit]):
        pen.line([(origin[0], origin[1]), (x, y)], fill=(*colour, 70), width=1)
        pen.ellipse([x - 2.0, y - 2.0, x + 2.0, y + 2.0], fill=(*colour, 220))


def _draw_badge(pen: Pen, text: str, speed: float, colour: Tint) -> None:
    """Speed and trigger in the upper left corner."""
    words = f"{3.6 * speed:3.0f} km/h" + (f"   {text}" if text else "")
    right = min(WIDTH - 8, 40 + 7 * len(words))
    pen.rounded_rectangle([8, 8, right, 32], 6, fill=(15, 18, 22, 170))
    pen.ellipse([15, 15, 25, 25], fill=(*colour, 255))
    pen.text((33, 14), words, fill=(240, 240, 240, 255))


def _project(points: Array) -> Array:
    """Pixels (n, 2) of points (n, 3) in the car's frame [m], x from the rear axle."""
    focal = 0.5 * HEIGHT / np.tan(0.5 * np.radians(FIELD_OF_VIEW))
    pitch = np.arctan2(ABOVE - 0.5, BEHIND + AHEAD)
    x, y, z = points[:, 0] + BEHIND, points[:, 1], points[:, 2] - ABOVE
    depth = np.maximum(x * np.cos(pitch) - z * np.sin(pitch), 0.5)
    up = x * np.sin(pitch) + z * np.cos(pitch)
    return np.stack([0.5 * WIDTH - focal * y / depth, 0.5 * HEIGHT - focal * up / depth], axis=1)
