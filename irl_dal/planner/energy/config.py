"""The energies' numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

EnergyForms = Literal["rollout", "printed"]


@dataclass(frozen=True, slots=True)
class EnergyConfig:
    """Weights and scales of Eq. dal_energy.

    Attributes:
        forms: `rollout` judges where the plan takes the car; `printed` uses the paper's lane and
            obstacle terms, which do not depend on the plan.
        lane_weight: w_base^lane; the paper does not give it.
        lane_hazard_gain: alpha_hazard of the lane weight; the paper does not give it.
        lane_scale: s_lane (Table II) [m].
        lane_preview: T [s]: the offset is judged where the heading leads within this time, so that
            guidance neither swings nor undoes a change of lane; 0 judges the offset itself.
        clearance_weight: w_base^lidar; the paper does not give it.
        safe_clearance: d_safe^plan [m]; the trigger distance of Table II.
        clearance_scale: s_lidar (Table II) [m].
        braking: The obstacle term also looks at the way on which the car stops after the plan with
            this deceleration [m/s^2], so that a plan leaves room to brake; None looks at the plan
            alone, 0.8 s.
        jerk_weight: w_jerk (Table II).
        stability_weight: w_stab (Table II).
        reference_speed: v_ref [m/s]; None takes the last executed speed. The paper does not say.
        slowest_reference: The last executed speed counts as at least this [m/s]: to keep a standing
            car standing is not what steady driving means.
        expert_weight: w_exp (Table II).

    Raises:
        ValueError: A value that cannot be meant.
    """

    forms: EnergyForms = "rollout"
    lane_weight: float = 1.0
    lane_hazard_gain: float = 1.0
    lane_scale: float = 0.5
    lane_preview: float = 1.0
    clearance_weight: float = 1.0
    safe_clearance: float = 3.0
    clearance_scale: float = 2.0
    braking: float | None = 4.0
    jerk_weight: float = 0.1
    stability_weight: float = 0.5
    reference_speed: float | None = None
    slowest_reference: float = 3.0
    expert_weight: float = 2.0

    def __post_init__(self) -> None:
        if self.forms not in get_args(EnergyForms):
            raise ValueError(f"`forms` must be one of {get_args(EnergyForms)}. Got {self.forms!r}.")
        for name in ("lane_scale", "safe_clearance", "clearance_scale"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"`{name}` must be finite and positive. Got {value}.")
        not_negative = (
            "lane_weight",
            "lane_hazard_gain",
            "lane_preview",
            "clearance_weight",
            "jerk_weight",
            "stability_weight",
            "slowest_reference",
            "expert_weight",
        )
        for name in not_negative:
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"`{name}` must be finite and not negative. Got {value}.")
        if self.braking is not None and not (math.isfinite(self.braking) and self.braking > 0):
            raise ValueError(f"`braking` must be finite and positive, or None. Got {self.braking}.")
        if self.reference_speed is not None and not math.isfinite(self.reference_speed):
            raise ValueError(
                f"`reference_speed` must be finite or None. Got {self.reference_speed}."
            )
