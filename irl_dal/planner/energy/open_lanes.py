"""Which lanes the car may want to be in, from what the scan shows in each.

E_lane pulls a plan to the nearest lane centre. While both lanes are open that is right: a change of
lane is not undone. Towards a lane that is blocked it is not: with an oncoming car in the passing
lane the nearest centre may be the one that the other car is on.
"""

from __future__ import annotations

import numpy as np

from expert import LaneMap
from irl_dal.planner.context import MAX_RANGE, PlanningContext

SIGHT = 25.0
"""A lane is open where this much of it is free, from the front bumper [m]."""

CORRIDOR = 1.45
"""Half width of the strip that must be free [m]."""

BESIDE = 1.0
"""Points up to this far behind the bumper still block a lane [m]."""


def open_lanes(context: PlanningContext) -> tuple[float, ...]:
    """The lateral offsets [m] of the admissible lanes that are open.

    Returns:
        Those with `SIGHT` free ahead; the freest one where none has; all without a lane estimate.
    """
    centres = context.lane_centres
    if not context.lane.valid:
        return centres
    lanes = LaneMap.build(context.scan, context.lane, MAX_RANGE)
    gaps = [lanes.gap(centre, CORRIDOR, -BESIDE) for centre in centres]
    free = tuple(centre for centre, gap in zip(centres, gaps, strict=True) if gap >= SIGHT)
    return free or (centres[int(np.argmax(gaps))],)
