"""A warm start for the critic: the first PPO updates should not follow an untrained one."""

import numpy as np
import torch
from torch import nn

from expert.replay import ReplayBuffer
from irl_dal.learning.reinforcement.policy import DrivingPolicy, observation_tensors

BATCH_SIZE, LEARNING_RATE = 256, 1e-3


def warm_start_critic(
    policy: DrivingPolicy,
    replay: ReplayBuffer,
    *,
    gamma: float,
    scale: float,
    steps: int,
    rng: np.random.Generator,
) -> float:
    """Regress the value head on the expert's discounted returns; the shared features stay.

    `gamma` is the discount factor, `scale` what the critic's rewards are multiplied with.

    Returns:
        Explained variance of the returns after training; NaN for an empty buffer or no steps.
    """
    if steps < 1 or not len(replay):
        return float("nan")
    slots, returns = replay.returns(gamma)
    with torch.no_grad():
        batches = np.array_split(slots, -(-len(slots) // BATCH_SIZE))
        seen = (observation_tensors(replay.gather(rows)) for rows in batches)
        features = torch.cat([policy.features(batch) for batch in seen])
    targets = torch.from_numpy(scale * returns)
    head = nn.Sequential(policy.mlp_extractor.value_net, policy.value_net)
    optimizer = torch.optim.Adam(head.parameters(), lr=LEARNING_RATE)
    for _ in range(steps):
        rows = torch.from_numpy(rng.integers(len(slots), size=BATCH_SIZE))
        loss = nn.functional.mse_loss(head(features[rows]).squeeze(1), targets[rows])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    optimizer.zero_grad()
    with torch.no_grad():
        left = (targets - head(features).squeeze(1)).var()
    return float(1.0 - left / targets.var().clamp(min=1e-12))
