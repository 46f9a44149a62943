"""What the perception module can be told."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

MaskNormalisation = Literal["bounded", "printed"]


@dataclass(frozen=True, slots=True)
class PerceptionConfig:
    """Scales and switches of the perception module.

    Attributes:
        max_speed: v_max of Eq. speed_norm [m/s]; the fastest command the actuators take.
        safe_distance: d_safe of Eq. hazard_level [m]; the paper does not give it. The distance that
            a car at `max_speed` needs to stop at 6 m/s^2.
        adaptive_mask: Whether the mask is the image's fourth channel; off for the ablation.
        normalisation: What Eq. mask_norm divides by: `bounded` the largest weight that the mask
            can have, `printed` the mask's own maximum, which cancels both learned factors.
        initial_alpha: First value of alpha_speed and alpha_lidar (Table II).
        exposure: Whether the image is brought to one brightness before it is encoded, as a camera's
            automatic exposure does (not in the paper).
        fuse_speed: Whether the normalised speed K_t also enters the fusion. The paper shows it to
            the policy only through the mask.

    Raises:
        ValueError: A value that cannot be meant.
    """

    max_speed: float = 12.0
    safe_distance: float = 12.0
    adaptive_mask: bool = True
    normalisation: MaskNormalisation = "bounded"
    initial_alpha: float = 0.5
    exposure: bool = True
    fuse_speed: bool = True

    def __post_init__(self) -> None:
        for name in ("max_speed", "safe_distance"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"`{name}` must be finite and positive. Got {value}.")
        if not (math.isfinite(self.initial_alpha) and self.initial_alpha > -1):
            raise ValueError(
                f"`initial_alpha` must be finite and above -1. Got {self.initial_alpha}."
            )
        if self.normalisation not in get_args(MaskNormalisation):
            raise ValueError(
                f"`normalisation` must be one of {get_args(MaskNormalisation)}. "
                f"Got {self.normalisation!r}."
            )
