"""Lane adherence, E_lane."""

from __future__ import annotations

import numpy as np

from irl_dal.planner.context import PlanningContext, hazard
from irl_dal.planner.energy.base import Array, ConstantEnergy, Energy, PlanBatch
from irl_dal.planner.energy.config import EnergyConfig
from irl_dal.planner.rollout import RoadRollout
from shield import ActuatorLimits


class LaneEnergy(Energy):
    r"""Mean over the roll-out of :math:`w_{lane} ((e_i - c) / s_{lane})^2`.

    e_i is the predicted lateral offset and c the admissible lane centre that the plan makes for;
    :math:`w_{lane} = w_{base} (1 + \alpha_{hazard} h_t)`.
    """

    name = "lane"

    def __init__(
        self, context: PlanningContext, config: EnergyConfig, limits: ActuatorLimits, horizon: int
    ) -> None:
        super().__init__(context, config, limits, horizon)
        self._centres = np.array(context.lane_centres)
        self._weight = lane_weight(context, config)

    @property
    def active(self) -> bool:
        """Without a lane estimate there is nothing to adhere to."""
        return self.context.lane.valid and self._weight > 0

    def evaluate(self, plans: PlanBatch) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2)."""
        lane = self.context.lane
        road = RoadRollout.of(
            plans.commands,
            self.limits.wheelbase,
            self.limits.dt,
            offset=lane.lateral_offset,
            heading=lane.heading_error,
            curvature=lane.curvature,
            curvature_rate=lane.curvature_rate,
        )
        error = road.offset - self._targets(road, plans.commands)
        factor = self._weight / (error.shape[1] * self.config.lane_scale**2)
        value = factor * np.einsum("bh,bh->b", error, error)
        error *= 2.0 * factor
        return value, self._per_action(road.pull_back(error))

    def _targets(self, road: RoadRollout, commands: Array) -> Array:
        """Lane centre that each plan makes for, (B, 1) or (B, H); constant for the gradient."""
        preview = self.config.lane_preview
        if preview > 0.0:
            ahead = np.sin(road.heading[:, -1:]) * commands[:, -1:, 1] * preview
            position = road.offset[:, -1:] + ahead
        else:
            position = road.offset
        nearest: Array = self._centres[np.abs(position[..., None] - self._centres).argmin(axis=-1)]
        return nearest


class PrintedLaneEnergy(ConstantEnergy):
    r"""The paper's :math:`w_{lane} (d_{lane,t} / s_{lane})^2` of the present deviation only."""

    name = "lane"

    @property
    def active(self) -> bool:
        """Without a lane estimate there is nothing to adhere to."""
        return self.context.lane.valid and self.config.lane_weight > 0

    def constant(self) -> float:
        """Energy of the present deviation from the nearest admissible centre."""
        scaled = self.context.lane_deviation / self.config.lane_scale
        return lane_weight(self.context, self.config) * scaled**2


def lane_weight(context: PlanningContext, config: EnergyConfig) -> float:
    """The risk-adaptive w_lane."""
    gain = config.lane_hazard_gain * hazard(context.nearest)
    return config.lane_weight * (1.0 + gain)
