"""Environment reward: dense, aware of the driving mode, every term by its own name.

The paper gives the ingredients (lane centring, obstacle clearance, goal, collision, near miss,
a baseline that keeps safe states positive) but no numbers; these are ours. A calm step is worth
about 1, so that the discriminator's reward in [-1, 1] weighs what `w_irl` says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from expert.modes import Mode
from irl_dal.envs.road import LANE_WIDTH


@dataclass(frozen=True, slots=True)
class RewardConfig:
    """Weights of the reward terms, all per step unless stated.

    Attributes:
        baseline: For every step that is not a near miss.
        progress: For driving along the road at `reference_speed`.
        reference_speed: Speed that earns the whole of `progress` [m/s].
        centring: For being in the middle of the lane that the mode asks for.
        centring_width: Offset at which centring has fallen to 1/e [m].
        clearance: Largest loss for being close to an obstacle.
        near_miss_distance: Clearance below which a step is a near miss [m].
        near_miss: Loss of a step that is a near miss.
        smoothness: Loss for a steering rate of 1 rad/s.
        collision: Loss, once.
        off_road: Loss, once.
        goal: Gain, once.
    """

    baseline: float = 0.1
    progress: float = 0.5
    reference_speed: float = 8.0
    centring: float = 0.4
    centring_width: float = 0.6
    clearance: float = 0.4
    near_miss_distance: float = 1.5
    near_miss: float = 0.5
    smoothness: float = 0.1
    collision: float = 20.0
    off_road: float = 20.0
    goal: float = 20.0

    def __post_init__(self) -> None:
        for name in ("reference_speed", "centring_width", "near_miss_distance"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"`{name}` must be positive. Got {getattr(self, name)}.")


@dataclass(frozen=True, slots=True)
class Situation:
    """What the reward looks at, from the true state.

    Attributes:
        mode: Driving mode.
        lateral_offset: To the left of the home lane's centre [m].
        speed: Along the road [m/s].
        clearance: Smallest distance to an obstacle [m].
        steering_rate: [rad/s].
        collision: The car has hit something.
        off_road: The car has left the road.
        success: The car has reached the goal.
    """

    mode: Mode
    lateral_offset: float
    speed: float
    clearance: float
    steering_rate: float
    collision: bool
    off_road: bool
    success: bool


def driving_mode(lateral_offset: float, gap: float, sight: float) -> Mode:
    """Mode that the true state calls for: the expert's four modes without their memory.

    Args:
        lateral_offset: To the left of the home lane's centre [m].
        gap: Free distance ahead in the home lane [m].
        sight: Distance at which an obstacle begins to matter [m].
    """
    passing = lateral_offset > 0.5 * LANE_WIDTH
    if gap < sight:
        return Mode.DRIVING_STRAIGHT if passing else Mode.OBSTACLE_AVOIDANCE
    return Mode.RETURNING if lateral_offset > 0.25 * LANE_WIDTH else Mode.LANE_FOLLOWING


def reward_terms(config: RewardConfig, now: Situation) -> dict[str, float]:
    """Every term of the reward; the reward is their sum."""
    off_centre = _off_centre(now)
    watchful = now.mode in (Mode.OBSTACLE_AVOIDANCE, Mode.DRIVING_STRAIGHT)
    closeness = float(np.clip(1.0 - now.clearance / (2.0 * config.near_miss_distance), 0.0, 1.0))
    near_miss = now.clearance < config.near_miss_distance
    return {
        "baseline": 0.0 if near_miss else config.baseline,
        "progress": config.progress * float(np.clip(now.speed / config.reference_speed, -1.0, 1.0)),
        "centring": config.centring * float(np.exp(-((off_centre / config.centring_width) ** 2))),
        "clearance": -config.clearance * closeness * (1.0 if watchful else 0.5),
        "near_miss": -config.near_miss if near_miss else 0.0,
        "smoothness": -config.smoothness * abs(now.steering_rate),
        "collision": -config.collision if now.collision else 0.0,
        "off_road": -config.off_road if now.off_road else 0.0,
        "goal": config.goal if now.success else 0.0,
    }


def _off_centre(now: Situation) -> float:
    """Distance to the middle of the lane that the mode asks for [m]."""
    home, passing = abs(now.lateral_offset), abs(now.lateral_offset - LANE_WIDTH)
    if now.mode is Mode.LANE_FOLLOWING:
        return home
    if now.mode is Mode.DRIVING_STRAIGHT:
        return passing
    return min(home, passing)
