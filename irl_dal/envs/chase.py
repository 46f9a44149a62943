"""A view from behind and above the car, for people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irl_dal.envs.vehicle import VehicleState
from irl_dal.envs.world import CameraPose, Illumination, World

BEHIND, ABOVE, AHEAD = 9.0, 4.5, 12.0
"""Where the camera flies and how far in front of the car it looks [m]."""


def chase_view(
    world: World, state: VehicleState, light: Illumination, width: int = 640, height: int = 360
) -> NDArray[np.uint8]:
    """Image (height, width, 3) uint8 of the car and the road ahead."""
    ahead = np.array([np.cos(state.yaw), np.sin(state.yaw)])
    here = np.array([state.x, state.y])
    eye, aim = here - BEHIND * ahead, here + AHEAD * ahead
    camera = CameraPose(
        eye=(float(eye[0]), float(eye[1]), ABOVE),
        target=(float(aim[0]), float(aim[1]), 0.5),
        field_of_view=50.0,
        width=width,
        height=height,
    )
    return world.render(camera, light)
