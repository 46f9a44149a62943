"""Observations with a label that can be learnt from them, for tests that need no simulator."""

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from expert.modes import Mode
from expert.replay import ReplayBuffer, Transition
from irl_dal.learning.collection.recorder import Counts, EpisodeEnd, StepRecord
from irl_dal.learning.reinforcement.hybrid_reward import HybridReward, HybridRewardConfig
from irl_dal.learning.reinforcement.policy import DrivingPolicy, build_policy
from irl_dal.perception import PerceptionConfig

OBSERVATION_SPACE = spaces.Dict(
    {
        "image": spaces.Box(0, 255, (64, 64, 3), np.uint8),
        "lidar": spaces.Box(0.0, 40.0, (180,), np.float32),
        "speed": spaces.Box(-50.0, 50.0, (1,), np.float32),
        "context": spaces.Box(-3.0, 3.0, (64,), np.float32),
    }
)

GAMMA = 0.9

ACTION_SPACE = spaces.Box(-1.0, 1.0, (2,), np.float32)


def new_policy(seed: int = 0, perception: PerceptionConfig | None = None) -> DrivingPolicy:
    """A policy with weights drawn from `seed`."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return build_policy(OBSERVATION_SPACE, ACTION_SPACE, perception or PerceptionConfig())


def observation(rng: np.random.Generator) -> dict[str, NDArray[np.generic]]:
    """One observation: an image, a scan whose left half tells the steering, a speed."""
    scan = rng.uniform(5.0, 40.0, 180).astype(np.float32)
    scan[90:] = rng.uniform(5.0, 40.0)
    return {
        "image": rng.integers(0, 256, (64, 64, 3), dtype=np.uint8),
        "lidar": scan,
        "speed": rng.uniform(0.0, 12.0, 1).astype(np.float32),
        "context": rng.normal(0.0, 0.1, 64).astype(np.float32),
    }


def label(seen: dict[str, NDArray[np.generic]]) -> NDArray[np.float32]:
    """What the expert of these tests does: steer by the left half of the scan, mind its speed."""
    return np.array([seen["lidar"][-1] / 40.0 - 0.5, 0.5 - seen["speed"][0] / 12.0], np.float32)


def filled_replay(
    size: int = 600, *, seed: int = 0, held_out_every: int = 10, expert_drove: bool = True
) -> ReplayBuffer:
    """A replay buffer with episodes of 20 steps, all modes, labels as `label` gives them."""
    rng, buffer = np.random.default_rng(seed), ReplayBuffer(size, held_out_every=held_out_every)
    for number in range(size):
        seen = observation(rng)
        buffer.add(
            Transition(
                image=seen["image"],
                lidar=seen["lidar"],
                speed=seen["speed"],
                context=seen["context"],
                label=label(seen),
                command=0.8 * label(seen),
                mode=Mode(number % 4),
                episode=number // 20,
                step=number % 20,
                reward=float(seen["speed"][0]) / 12.0,
                terminated=number % 20 == 19,
                intervened=False,
                expert_drove=expert_drove,
            )
        )
    return buffer


def hybrid(**arguments: object) -> HybridReward:
    """A hybrid reward with some fields of its configuration changed."""
    return HybridReward(HybridRewardConfig(**arguments), GAMMA)  # type: ignore[arg-type]


def record(
    seen: dict[str, NDArray[np.generic]],
    env_reward: float = 0.0,
    *,
    end: EpisodeEnd = EpisodeEnd.GOES_ON,
    executed: float = 0.0,
    step: int = 1,
    intervened: bool = False,
) -> StepRecord:
    """A step of the policy, with the same executed steering and speed."""
    transition = Transition(
        image=seen["image"],
        lidar=seen["lidar"],
        speed=seen["speed"],
        context=seen["context"],
        label=label(seen),
        command=np.full(2, executed, np.float32),
        mode=Mode.LANE_FOLLOWING,
        episode=0,
        step=step,
        reward=env_reward,
        terminated=end in (EpisodeEnd.SUCCESS, EpisodeEnd.FAILURE),
        intervened=intervened,
        expert_drove=False,
    )
    return StepRecord(transition, end, Counts(steps=1), 0.0)
