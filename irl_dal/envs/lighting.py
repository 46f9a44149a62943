"""Light from a bright day to a dark evening, one draw an episode."""

from __future__ import annotations

import numpy as np

from irl_dal.envs.world import Colour, Illumination


def _mix(dark: Colour, bright: Colour, share: float) -> Colour:
    r, g, b = ((1.0 - share) * a + share * z for a, z in zip(dark, bright, strict=True))
    return (r, g, b)


def daylight(brightness: float, azimuth: float) -> Illumination:
    """Light for a time of day.

    Args:
        brightness: 0 is a dark evening, 0.5 about dusk, 1 noon.
        azimuth: Direction of the sun [rad].
    """
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


def draw_light(rng: np.random.Generator, low: float, high: float) -> Illumination:
    """Draw a time of day with `brightness` uniform in [`low`, `high`]."""
    return daylight(float(rng.uniform(low, high)), float(rng.uniform(-np.pi, np.pi)))
