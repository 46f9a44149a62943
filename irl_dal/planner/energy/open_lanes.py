"""Which lanes are open to the car, from what the scan shows in each.

E_lane pulls a plan to the nearest open lane's centre. Pulled to the nearest of all, a car beside an
oncoming one in the passing lane would be pulled into its path.
"""

import numpy as np

from expert import LaneMap
from expert.fsm import BESIDE, CORRIDOR
from irl_dal.planner.context import PlanningContext

SIGHT = 25.0  # A lane is open where this much of it is free, from the front bumper [m]


def open_lanes(context: PlanningContext) -> tuple[float, ...]:
    """The lateral offsets [m] of the admissible lanes that are open.

    Returns:
        Those with `SIGHT` free ahead; the freest one where none has; all without a lane estimate.
    """
    centres = context.lane_centres
    if not context.lane.valid:
        return centres
    lanes = LaneMap.build(context.scan, context.lane, context.geometry)
    gaps = [lanes.gap(centre, CORRIDOR, -BESIDE) for centre in centres]
    free = tuple(centre for centre, gap in zip(centres, gaps, strict=True) if gap >= SIGHT)
    return free or (centres[int(np.argmax(gaps))],)
