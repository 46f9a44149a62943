"""Lane adherence, E_lane."""

import math

import numpy as np

from expert import LaneMap
from expert.fsm import BESIDE, CORRIDOR
from irl_dal.arrays import Array
from irl_dal.planner.context import PlanningContext
from irl_dal.planner.energy.base import Energy, risk_adaptive
from irl_dal.planner.rollout import LanePose, road_gradient, road_rollout
from irl_dal.shortcuts import compiled

# The offset is judged where the heading leads within this time [s], so that guidance neither swings
# nor undoes a change of lane
PREVIEW = 1.0
SIGHT = 25.0  # A lane is open where this much of it is free, from the front bumper [m]


def open_lanes(context: PlanningContext) -> tuple[float, ...]:
    """The lateral offsets [m] of the admissible lanes that the scan shows to be open.

    Those with `SIGHT` free ahead; the freest where none has; all without a lane estimate. Pulled to
    the nearest lane of all, a car beside an oncoming one would be pulled into its path.
    """
    centres = context.lane_centres
    if not context.lane.valid:
        return centres
    lanes = LaneMap.build(context.scan, context.lane, context.geometry)
    gaps = [lanes.gap(centre, CORRIDOR, -BESIDE) for centre in centres]
    free = tuple(centre for centre, gap in zip(centres, gaps, strict=True) if gap >= SIGHT)
    return free or (centres[int(np.argmax(gaps))],)


class LaneEnergy(Energy):
    r"""Mean over the roll-out of :math:`w_{lane} ((e_i - c) / s_{lane})^2`.

    :math:`e_i = d_i + T v_i \sin\psi_i` is the lateral offset that the car would have a preview
    time T after step i if it kept its heading: the error of a driver who looks ahead, which damps
    what the offset alone would make swing. c is the open lane's centre nearest to where the
    plan's end leads; :math:`w_{lane} = w_{base} (1 + h_t)`: the paper does not give its
    :math:`\alpha_{hazard}`, here 1.
    """

    def prepare(self) -> None:
        """Set the weight, 0 without a lane estimate, the open lanes and the pose."""
        lane = self.context.lane
        self.weight = risk_adaptive(self.config.lane_weight, self.context) if lane.valid else 0.0
        self._centres = np.array(open_lanes(self.context))
        pose = (lane.lateral_offset, lane.heading_error, lane.curvature, lane.curvature_rate)
        self._start = LanePose(*map(float, pose))

    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2)."""
        value, gradient = _deviation(
            self.scale.to_command(actions),
            self._start,
            self._centres,
            self.weight / self.config.lane_scale**2,
            self.limits.wheelbase,
            self.limits.dt,
        )
        return value, gradient * self.scale.half


@compiled
def _deviation(
    commands: Array, start: LanePose, centres: Array, weight: float, wheelbase: float, dt: float
) -> tuple[Array, Array]:
    """`weight` times the mean over H of (e_i - c)^2, and its derivative per command."""
    road = road_rollout(commands, wheelbase, dt, start)
    batch, horizon = road.offset.shape
    value = np.zeros(batch)
    doffset, dheading = np.empty((batch, horizon)), np.empty((batch, horizon))
    for b in range(batch):
        end = road.offset[b, -1] + PREVIEW * commands[b, -1, 1] * math.sin(road.heading[b, -1])
        centre = centres[np.argmin(np.abs(end - centres))]  # a constant for the gradient
        for i in range(horizon):
            seen = PREVIEW * commands[b, i, 1]
            error = road.offset[b, i] + seen * math.sin(road.heading[b, i]) - centre
            value[b] += weight / horizon * error * error
            doffset[b, i] = 2.0 * weight / horizon * error
            dheading[b, i] = doffset[b, i] * seen * math.cos(road.heading[b, i])
    gradient = road_gradient(road, doffset, dheading)
    for b, i in np.ndindex(batch, horizon):
        gradient[b, i, 1] += PREVIEW * doffset[b, i] * math.sin(road.heading[b, i])
    return value, gradient
