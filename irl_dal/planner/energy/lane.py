"""Lane adherence, E_lane."""

from __future__ import annotations

import numpy as np

from irl_dal.planner.context import PlanningContext, hazard
from irl_dal.planner.energy.base import Array, ConstantEnergy, Energy, PlanBatch
from irl_dal.planner.energy.config import EnergyConfig
from irl_dal.planner.energy.open_lanes import open_lanes
from irl_dal.planner.rollout import RoadRollout
from shield import ActuatorLimits


class LaneEnergy(Energy):
    r"""Mean over the roll-out of :math:`w_{lane} ((e_i - c) / s_{lane})^2`.

    :math:`e_i = d_i + T v_i \sin\psi_i` is the lateral offset that the car would have a preview
    time T after step i if it kept its heading: the error of a driver who looks ahead, which damps
    what the offset alone would make swing. c is the open lane's centre nearest to where the
    plan's end leads; :math:`w_{lane} = w_{base} (1 + \alpha_{hazard} h_t)`.
    """

    name = "lane"

    def __init__(
        self, context: PlanningContext, config: EnergyConfig, limits: ActuatorLimits, horizon: int
    ) -> None:
        super().__init__(context, config, limits, horizon)
        self._centres = np.array(open_lanes(context))
        self._weight = lane_weight(context, config)

    @property
    def active(self) -> bool:
        """Without a lane estimate there is nothing to adhere to."""
        return self.context.lane.valid and self._weight > 0

    def evaluate(self, plans: PlanBatch) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2)."""
        lane, preview = self.context.lane, self.config.lane_preview
        road = RoadRollout.of(
            plans.commands,
            self.limits.wheelbase,
            self.limits.dt,
            offset=lane.lateral_offset,
            heading=lane.heading_error,
            curvature=lane.curvature,
            curvature_rate=lane.curvature_rate,
        )
        seen = preview * plans.commands[..., 1]
        drift = np.sin(road.heading)
        place = road.offset + seen * drift
        error = place - self._nearest_centre(place[:, -1:])
        factor = self._weight / (error.shape[1] * self.config.lane_scale**2)
        value = factor * np.einsum("bh,bh->b", error, error)
        error *= 2.0 * factor
        gradient = road.pull_back(error, error * seen * np.cos(road.heading))
        gradient[..., 1] += preview * error * drift
        return value, self._per_action(gradient)

    def _nearest_centre(self, place: Array) -> Array:
        """The admissible lane centre nearest to a place (B, 1); constant for the gradient."""
        nearest: Array = self._centres[np.abs(place[..., None] - self._centres).argmin(axis=-1)]
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
