"""The paper's learnable adaptive mask (LAM): a vertical gradient that grows with speed and hazard.

| variable             | paper                | equation           |
|----------------------|----------------------|--------------------|
| `speed_level`        | v_t^norm             | speed_norm         |
| `hazard_level`       | h_t                  | hazard_level       |
| `alpha_speed`        | alpha_speed          | modulation_factors |
| `alpha_lidar`        | alpha_lidar          | modulation_factors |
| `lower`              | w_lower              | lower_weight       |
| `mask` before / after| M_t / M-hat_t        | mask_gradient / mask_norm |
"""

import torch
from torch import Tensor, nn

from irl_dal.perception.config import PerceptionConfig

# d_safe of Eq. hazard_level [m]; the paper does not give it: where a car stops from 12 m/s at 6
# m/s^2.
SAFE_DISTANCE = 12.0
EPSILON = 1e-6  # The epsilon of Eq. mask_norm


class LearnableAdaptiveMask(nn.Module):
    """Mask over the image rows, driven by speed and by the nearest LiDAR return.

    The base weight is 0 at the top row and 1 at the bottom row. Learning moves only the two alphas.
    """

    def __init__(self, config: PerceptionConfig) -> None:
        super().__init__()
        self.config = config
        self.alpha_speed = nn.Parameter(torch.tensor(config.initial_alpha))
        self.alpha_lidar = nn.Parameter(torch.tensor(config.initial_alpha))

    def speed_level(self, speed: Tensor) -> Tensor:
        """Eq. speed_norm: speed [m/s] of any shape to [0, 1]."""
        return (speed / self.config.max_speed).clamp(0.0, 1.0)

    def hazard_level(self, lidar: Tensor) -> Tensor:
        """Eq. hazard_level: scan (B, n) [m] to (B, 1) in [0, 1]; 1 is contact."""
        nearest = lidar.amin(dim=1, keepdim=True)
        return ((SAFE_DISTANCE - nearest) / SAFE_DISTANCE).clamp(0.0, 1.0)

    def lower_weight(self, speed_level: Tensor, hazard_level: Tensor) -> Tensor:
        """Eqs. modulation_factors and lower_weight, elementwise."""
        return (1.0 + self.alpha_speed * speed_level) * (1.0 + self.alpha_lidar * hazard_level)

    def forward(self, speed: Tensor, lidar: Tensor, rows: int) -> Tensor:
        """M-hat_t (B, 1, rows, 1) in [0, 1], of speed (B, 1) [m/s] and scan (B, n) [m]."""
        lower = self.lower_weight(self.speed_level(speed), self.hazard_level(lidar))
        ramp = torch.linspace(0.0, 1.0, rows, dtype=lower.dtype, device=lower.device)
        mask = lower * ramp  # Eq. mask_gradient, (B, rows)
        if self.config.normalisation == "printed":
            mask = mask / (mask.amax(dim=1, keepdim=True) + EPSILON)
        else:  # the largest weight over all speeds and hazards, for alphas of at least -1
            alphas = self.alpha_speed.clamp(min=0.0), self.alpha_lidar.clamp(min=0.0)
            largest = (1.0 + alphas[0]) * (1.0 + alphas[1])
            mask = (mask / (largest + EPSILON)).clamp(0.0, 1.0)
        return mask[:, None, :, None]
