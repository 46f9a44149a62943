"""Which lanes the car may want to be in, from what the scan shows in each.

E_lane pulls a plan to the nearest lane centre. While both lanes are open that is right: a change of
lane is not undone. Towards a lane that is blocked it is not: with an oncoming car in the passing
lane the nearest centre may be the one that the other car is on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from expert import LaneMap
from shield import LaneEstimate

Array = NDArray[np.float64]

SIGHT = 25.0
"""A lane is open where this much of it is free, from the front bumper [m]."""

CORRIDOR = 1.45
"""Half width of the strip that must be free [m]."""

BESIDE = 1.0
"""Points up to this far behind the bumper still block a lane [m]."""


def open_lanes(
    scan: Array, lane: LaneEstimate, centres: Sequence[float], max_range: float
) -> tuple[float, ...]:
    """The centres of the open lanes.

    Args:
        scan: LiDAR ranges (beams,) over 180 degrees, beam 0 at the right [m].
        lane: Filtered lane pose.
        centres: Of all admissible lanes, as lateral offsets [m].
        max_range: Reading of a beam without a return [m].

    Returns:
        Those with `SIGHT` free ahead; the freest one where none has; all without a lane estimate.
    """
    if not lane.valid:
        return tuple(centres)
    lanes = LaneMap.build(scan, lane, max_range)
    gaps = [lanes.gap(centre, CORRIDOR, -BESIDE) for centre in centres]
    free = tuple(centre for centre, gap in zip(centres, gaps, strict=True) if gap >= SIGHT)
    return free or (centres[int(np.argmax(gaps))],)
