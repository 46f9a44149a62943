"""The expert's four behaviour modes (paper, Sec. III: the FSM's states)."""

from enum import IntEnum


class Mode(IntEnum):
    """What the expert is doing; the number is the index of the replay partition."""

    LANE_FOLLOWING = 0
    OBSTACLE_AVOIDANCE = 1
    DRIVING_STRAIGHT = 2
    RETURNING = 3
