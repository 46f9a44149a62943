"""The energies' numbers."""

import math
from dataclasses import dataclass
from typing import Literal

from irl_dal.checks import check_choices
from shield.errors import check_positive, check_within

EnergyForms = Literal["rollout", "printed"]


@dataclass(frozen=True, slots=True)
class EnergyConfig:
    """Weights and scales of Eq. dal_energy."""

    # `rollout` judges where the plan takes the car; `printed` uses the paper's lane and obstacle
    # terms, which do not depend on the plan
    forms: EnergyForms = "rollout"
    lane_weight: float = 1.0  # w_base^lane; the paper does not give it
    lane_scale: float = 0.5  # s_lane (Table II) [m]
    clearance_weight: float = 1.0  # w_base^lidar; the paper does not give it
    safe_clearance: float = 3.0  # d_safe^plan [m]; the trigger distance of Table II
    clearance_scale: float = 2.0  # s_lidar (Table II) [m]
    # E_lidar also looks at the way on which the car stops after the plan with this deceleration
    # [m/s^2], so that a plan leaves room to brake; None looks at the plan alone, 0.8 s
    braking: float | None = 4.0
    jerk_weight: float = 0.1  # w_jerk (Table II)
    stability_weight: float = 0.5  # w_stab (Table II)
    # v_ref is the last executed speed, but at least this [m/s]: otherwise a car at rest is held at
    # rest. The paper does not say what v_ref is.
    slowest_reference: float = 3.0
    expert_weight: float = 2.0  # w_exp (Table II)

    def __post_init__(self) -> None:
        check_choices(self)
        scales = ("lane_scale", "safe_clearance", "clearance_scale")
        check_positive(ValueError, **{name: getattr(self, name) for name in scales})
        weights = [name for name in self.__slots__ if name.endswith("_weight")]
        for name in (*weights, "slowest_reference"):
            check_within(ValueError, 0.0, math.inf, **{name: getattr(self, name)})
        if self.braking is not None:
            check_positive(ValueError, braking=self.braking)
