"""Light from a bright day to a dark evening, one draw an episode."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from irl_dal.arrays import Array, Colour


@dataclass(frozen=True, slots=True)
class Illumination:
    """What the renderer needs to know of the light."""

    direction: Sequence[float]  # Where the light comes from (3,), any length
    colour: Colour  # RGB in [0, 1]
    ambient: float  # Share of light that falls on every face
    diffuse: float  # Share of light that depends on the face's inclination
    sky: Colour  # RGB in [0, 1] of what no body covers above the horizon
    brightness: float = 1.0  # Time of day that it stands for, 0 a dark evening, 1 noon

    def on_ground(self, colour: Colour) -> Array:
        """What a level surface of a colour looks like, RGB (3,) in [0, 255], as rendered."""
        height = float(np.asarray(self.direction)[2] / np.linalg.norm(self.direction))
        shade = self.ambient + self.diffuse * max(0.0, height) * np.asarray(self.colour)
        return np.asarray(255.0 * np.asarray(colour) * shade)


def _mix(dark: Colour, bright: Colour, share: float) -> Colour:
    r, g, b = ((1.0 - share) * a + share * z for a, z in zip(dark, bright, strict=True))
    return (r, g, b)


def draw_light(rng: np.random.Generator, low: float, high: float) -> Illumination:
    """Draw a time of day with `brightness` uniform in [`low`, `high`], 0 a dark evening, 1 noon."""
    brightness, azimuth = float(rng.uniform(low, high)), float(rng.uniform(-np.pi, np.pi))
    elevation = 0.25 + 1.0 * brightness
    level = 0.30 + 0.70 * brightness
    warm = _mix((1.0, 0.78, 0.62), (1.0, 1.0, 0.97), brightness)
    r, g, b = (level * c for c in warm)
    return Illumination(
        direction=(
            float(np.cos(azimuth) * np.cos(elevation)),
            float(np.sin(azimuth) * np.cos(elevation)),
            float(np.sin(elevation)),
        ),
        colour=(r, g, b),
        ambient=0.30 + 0.25 * brightness,
        diffuse=0.45,
        sky=_mix((0.05, 0.06, 0.13), (0.56, 0.75, 0.93), brightness),
        brightness=brightness,
    )
