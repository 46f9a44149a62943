"""How much of the planner's action reaches the car, Eqs. blend_critical, blend_hazard, final_blend.

| variable           | paper           | equation       |
|--------------------|-----------------|----------------|
| `clearance`        | d_min,t         | blend_hazard   |
| `lane_deviation`   | d_lane,t        | blend_hazard   |
| `distance_scale`   | s_1             | blend_hazard   |
| `deviation_scale`  | s_2             | blend_hazard   |
| `base`, 1 - `base` | w_base^blend, w_scale^blend | blend_critical |
| weight             | w_b             | final_blend    |
"""

import math
from dataclasses import dataclass

import numpy as np

from irl_dal.arrays import Array
from shield.errors import check_positive, check_within

# Share of the new weight in its exponential moving average; the paper does not give it
SMOOTHING = 0.5


@dataclass(frozen=True, slots=True)
class BlendConfig:
    """Numbers of the blend."""

    # d_critical (Table II) [m]; nearer than this the planner drives alone
    critical_clearance: float = 1.5
    # w_base^blend; the paper does not give it. 0.5 saves a disturbed policy more often than 0.3
    # does. w_scale^blend is 1 - base, so that the weight is 1 at contact.
    base: float = 0.5
    distance_scale: float = 2.0  # s_1 (Table II) [m]
    deviation_scale: float = 0.2  # s_2 [m]: Table II's 20 px at 1 px for 1 cm
    deviation_gain: float = 0.3  # k_tanh (Table II)
    # Whether the average also delays the critical weight, as the paper can be read
    smooth_critical: bool = False

    def __post_init__(self) -> None:
        scales = {"distance_scale": self.distance_scale, "deviation_scale": self.deviation_scale}
        check_positive(ValueError, **scales)
        critical, gain = self.critical_clearance, self.deviation_gain
        check_within(ValueError, 0.0, math.inf, critical_clearance=critical, deviation_gain=gain)
        check_within(ValueError, 0.0, 1.0, base=self.base)


class ActionBlend:
    """The blend weight w_b with its moving average."""

    def __init__(self, config: BlendConfig | None = None) -> None:
        self.config = config or BlendConfig()
        self._average: float | None = None

    def reset(self) -> None:
        """Forget the average: at the start of an episode and when the trigger releases."""
        self._average = None

    def hazard(self, clearance: float, lane_deviation: float) -> float:
        """Eq. blend_hazard; clearance and lane deviation in metres."""
        config = self.config
        near = math.exp(-max(0.0, clearance) / config.distance_scale)
        astray = math.tanh(abs(lane_deviation) / config.deviation_scale)
        return near + config.deviation_gain * astray

    def instantaneous(self, clearance: float, lane_deviation: float) -> float:
        """Eq. blend_critical, limited to [0, 1]; NaN counts as the worst case."""
        clearance = 0.0 if math.isnan(clearance) else clearance
        lane_deviation = math.inf if math.isnan(lane_deviation) else lane_deviation
        if clearance < self.config.critical_clearance:
            return 1.0
        base = self.config.base
        return min(1.0, base + (1.0 - base) * self.hazard(clearance, lane_deviation))

    def weight(self, clearance: float, lane_deviation: float, *, stalled: bool = False) -> float:
        """The smoothed w_b in [0, 1] of a step on which the planner is used.

        Of d_min and d_lane [m]; NaN counts as the worst case. Where the policy stands still
        (`stalled`), the planner drives alone: a share of the policy would hold the wheels askew.
        """
        weight = 1.0 if stalled else self.instantaneous(clearance, lane_deviation)
        critical = clearance < self.config.critical_clearance or math.isnan(clearance)
        at_once = stalled or (critical and not self.config.smooth_critical)
        if self._average is None or at_once:
            self._average = weight
        else:
            self._average += SMOOTHING * (weight - self._average)
        return self._average

    @staticmethod
    def blend(planned: Array, nominal: Array, weight: float) -> Array:
        """Eq. final_blend: weight * planned + (1 - weight) * nominal, both (2,) in one unit."""
        return np.asarray(weight * planned + (1.0 - weight) * nominal, dtype=np.float64)
