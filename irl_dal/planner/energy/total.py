"""The composite energy, Eq. dal_energy."""

from __future__ import annotations

import numpy as np

from irl_dal.planner.action_scale import ActionScale
from irl_dal.planner.context import PlanningContext
from irl_dal.planner.energy.base import Array, Energy, PlanBatch
from irl_dal.planner.energy.clearance import ClearanceEnergy, PrintedClearanceEnergy
from irl_dal.planner.energy.config import EnergyConfig
from irl_dal.planner.energy.lane import LaneEnergy, PrintedLaneEnergy
from irl_dal.planner.energy.smoothness import ExpertEnergy, JerkEnergy, StabilityEnergy
from shield import ActuatorLimits

ROLLOUT_TERMS: tuple[type[Energy], ...] = (
    LaneEnergy,
    ClearanceEnergy,
    JerkEnergy,
    StabilityEnergy,
    ExpertEnergy,
)

PRINTED_TERMS: tuple[type[Energy], ...] = (
    PrintedLaneEnergy,
    PrintedClearanceEnergy,
    JerkEnergy,
    StabilityEnergy,
    ExpertEnergy,
)


class TotalEnergy:
    """E = E_lane + E_lidar + E_jerk + E_stability + E_expert for one planning context.

    Args:
        context: What is known now.
        config: Weights, scales and forms.
        limits: Actuators.
        horizon: H of the plans.

    Attributes:
        terms: The terms that have something to say here.
    """

    def __init__(
        self, context: PlanningContext, config: EnergyConfig, limits: ActuatorLimits, horizon: int
    ) -> None:
        self._scale = ActionScale(limits)
        kinds = ROLLOUT_TERMS if config.forms == "rollout" else PRINTED_TERMS
        terms = (kind(context, config, limits, horizon) for kind in kinds)
        self.terms = tuple(term for term in terms if term.active)

    def value(self, actions: Array) -> Array:
        """Energies (B,) of normalised actions (B, H, 2)."""
        return self.evaluate(actions)[0]

    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and their gradients (B, H, 2), for normalised actions (B, H, 2)."""
        plans = PlanBatch.of(actions, self._scale)
        value, gradient = np.zeros(len(actions)), np.zeros_like(actions)
        for term in self.terms:
            part, slope = term.evaluate(plans)
            value += part
            gradient += slope
        return value, gradient

    def parts(self, actions: Array) -> dict[str, Array]:
        """Energies (B,) of each term by name."""
        plans = PlanBatch.of(actions, self._scale)
        return {term.name: term.evaluate(plans)[0] for term in self.terms}
