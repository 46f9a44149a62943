"""What the perception module can be told."""

import math
from dataclasses import dataclass
from typing import Literal

from irl_dal.checks import check_choices
from shield.errors import check_positive

MaskNormalisation = Literal["bounded", "printed"]


@dataclass(frozen=True, slots=True)
class PerceptionConfig:
    """Scales and switches of the perception module."""

    max_speed: float = 12.0  # v_max of Eq. speed_norm [m/s]; the fastest command
    adaptive_mask: bool = True  # The mask is the image's fourth channel; off for the ablation
    # What Eq. mask_norm divides by: `bounded` the largest weight that the mask can have, `printed`
    # the mask's own maximum, which cancels both learned factors.
    normalisation: MaskNormalisation = "bounded"
    initial_alpha: float = 0.5  # First value of alpha_speed and alpha_lidar (Table II)
    exposure: bool = True  # Images are encoded at one brightness (not in the paper)
    # Filtered estimates (the planner's c_t) enter the fusion: one frame does not show what moves,
    # nor where the lane was (not in the paper)
    fuse_context: bool = True
    fuse_speed: bool = True  # K_t also enters the fusion; in the paper only the mask shows it

    def __post_init__(self) -> None:
        check_positive(ValueError, max_speed=self.max_speed)
        if not (math.isfinite(self.initial_alpha) and self.initial_alpha > -1):
            raise ValueError(
                f"`initial_alpha` must be finite and above -1. Got {self.initial_alpha}."
            )
        check_choices(self)
