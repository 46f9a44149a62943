"""Environment reward: dense, aware of the driving mode, every term by its own name.

The paper gives the ingredients (lane centring, obstacle clearance, goal, collision, near miss,
a baseline that keeps safe states positive) but no numbers; these are ours. A calm step is worth
about 1, so that the discriminator's reward in [-1, 1] weighs what `w_irl` says.
"""

from dataclasses import dataclass

import numpy as np

from expert.modes import Mode
from irl_dal.checks import Ranges, check_ranges
from irl_dal.envs.road import LANE_WIDTH

BASELINE = 0.1  # For every step that is not a near miss: a calm standstill still beats a near miss
# Largest loss for being close to an obstacle, and loss of a step that is a near miss: together they
# outweigh the progress of a step
CLEARANCE, NEAR_MISS = 0.4, 0.5
SMOOTHNESS = 0.1  # Loss for a steering rate of 1 rad/s
REFERENCE_SPEED = 8.0  # Earns the whole of `progress` [m/s]; the expert cruises at 9
CENTRING = 0.4  # For a step in the middle of the lane that the mode asks for
CENTRING_WIDTH = 0.6  # Offset at which centring has fallen to 1/e [m]: a third of a car's width
NEAR_MISS_DISTANCE = 1.5  # Clearance of a near miss [m], half a metre above d_collision
SIGHT = 25.0  # Distance at which an obstacle changes the mode [m]
RELAXED = 0.5  # Share of the clearance loss while no obstacle is being passed
RANGES: Ranges = dict.fromkeys(("progress", "crash", "goal"), (0.0, 1e6))


@dataclass(frozen=True, slots=True)
class RewardConfig:
    """Weights of the reward terms that a user turns; the others are constants above."""

    progress: float = 0.5  # For a step along the road at `REFERENCE_SPEED`
    crash: float = 20.0  # Loss for a collision or for leaving the road, once
    goal: float = 20.0  # Gain for the goal, once

    def __post_init__(self) -> None:
        check_ranges(self, RANGES)


@dataclass(frozen=True, slots=True)
class Situation:
    """What the reward looks at, from the true state."""

    mode: Mode  # Driving mode
    lateral_offset: float  # To the left of the home lane's centre [m]
    speed: float  # Along the road [m/s]
    clearance: float  # Smallest distance to an obstacle [m]
    steering_rate: float  # [rad/s]
    collision: bool  # The car has hit something
    off_road: bool  # The car has left the road
    success: bool  # The car has reached the goal


def driving_mode(lateral_offset: float, gap: float) -> Mode:
    """Mode for a free distance `gap` ahead in the home lane [m]: the expert's, without memory."""
    passing = lateral_offset > 0.5 * LANE_WIDTH
    if gap < SIGHT:
        return Mode.DRIVING_STRAIGHT if passing else Mode.OBSTACLE_AVOIDANCE
    return Mode.RETURNING if lateral_offset > 0.25 * LANE_WIDTH else Mode.LANE_FOLLOWING


def reward_terms(config: RewardConfig, now: Situation) -> dict[str, float]:
    """Every term of the reward; the reward is their sum."""
    # Distance to the middle of the lane that the mode asks for [m]; between the lanes of either
    home, passing = abs(now.lateral_offset), abs(now.lateral_offset - LANE_WIDTH)
    asked = {Mode.LANE_FOLLOWING: home, Mode.DRIVING_STRAIGHT: passing}
    off_centre = asked.get(now.mode, min(home, passing))
    watchful = now.mode in (Mode.OBSTACLE_AVOIDANCE, Mode.DRIVING_STRAIGHT)
    closeness = float(np.clip(1.0 - now.clearance / (2.0 * NEAR_MISS_DISTANCE), 0.0, 1.0))
    near_miss = now.clearance < NEAR_MISS_DISTANCE
    return {
        "baseline": 0.0 if near_miss else BASELINE,
        "progress": config.progress * float(np.clip(now.speed / REFERENCE_SPEED, -1.0, 1.0)),
        "centring": CENTRING * float(np.exp(-((off_centre / CENTRING_WIDTH) ** 2))),
        "clearance": -CLEARANCE * closeness * (1.0 if watchful else RELAXED),
        "near_miss": -NEAR_MISS if near_miss else 0.0,
        "smoothness": -SMOOTHNESS * abs(now.steering_rate),
        "collision": -config.crash if now.collision else 0.0,
        "off_road": -config.crash if now.off_road else 0.0,
        "goal": config.goal if now.success else 0.0,
    }
