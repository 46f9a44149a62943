"""The composite energy, Eq. dal_energy."""

import numpy as np

from irl_dal.arrays import Array
from irl_dal.planner.context import PlanningContext
from irl_dal.planner.energy.base import Energy, risk_adaptive
from irl_dal.planner.energy.clearance import ClearanceEnergy
from irl_dal.planner.energy.config import EnergyConfig
from irl_dal.planner.energy.lane import LaneEnergy
from irl_dal.planner.energy.smoothness import ExpertEnergy, JerkEnergy, StabilityEnergy
from shield import ActuatorLimits


class TotalEnergy:
    """E = E_lane + E_lidar + E_jerk + E_stability + E_expert for one planning context.

    As printed, E_lane and E_lidar depend on the present state alone: a `constant` that is added to
    the `terms`, without gradient.
    """

    def __init__(
        self, context: PlanningContext, config: EnergyConfig, limits: ActuatorLimits, horizon: int
    ) -> None:
        kinds: list[type[Energy]] = [JerkEnergy, StabilityEnergy, ExpertEnergy]
        self.constant = 0.0
        if config.forms == "printed":
            self.constant = _present_energy(context, config)
        else:
            kinds = [LaneEnergy, ClearanceEnergy, *kinds]
        terms = (kind(context, config, limits, horizon) for kind in kinds)
        self.terms = tuple(term for term in terms if term.active)

    def value(self, actions: Array) -> Array:
        """Energies (B,) of normalised actions (B, H, 2)."""
        return self.evaluate(actions)[0]

    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and their gradients (B, H, 2), for normalised actions (B, H, 2)."""
        value, gradient = np.full(len(actions), self.constant), np.zeros_like(actions)
        for term in self.terms:
            part, slope = term.evaluate(actions)
            value += part
            gradient += slope
        return value, gradient


def _present_energy(context: PlanningContext, config: EnergyConfig) -> float:
    """The paper's E_lane and E_lidar, of the present deviation and clearance only."""
    gap = max(0.0, (config.safe_clearance - context.nearest) / config.clearance_scale)
    energy = risk_adaptive(config.clearance_weight, context) * gap**2
    if context.lane.valid:
        weight = risk_adaptive(config.lane_weight, context)
        energy += weight * (context.lane_deviation / config.lane_scale) ** 2
    return energy
