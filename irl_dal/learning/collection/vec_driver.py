"""The cars of a training together, in one process or in several.

Wherever they are, they drive the same steps, and come in the same order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from irl_dal.learning.collection.step_record import DrivenStep
from irl_dal.planner import DiffusionPlanner

__all__ = ["Fleet"]

BLOCK = 250
"""Steps of a demonstration that each car drives before it waits for the others: slow and fast ones
even out, and two cars are done when the next update is due (Table II)."""


class Fleet:
    """Asks all cars at once.

    Args:
        drivers: A vector of `Driver`.
    """

    def __init__(self, drivers: VecEnv) -> None:
        self.drivers = drivers

    def begin_at(self, episodes: Sequence[int]) -> None:
        """Number of the episode that each car begins next."""
        for car, episode in enumerate(episodes):
            self.drivers.env_method("begin_at", episode, indices=[car])

    def demonstrations(self, steps: int) -> Iterator[DrivenStep]:
        """At least so many steps of the expert, of all cars together, the cars in turn.

        The expert drives the same whatever has been learnt, so a car needs nothing from the
        learners or from other cars.
        """
        each = -(-steps // self.drivers.num_envs)
        for begun in range(0, each, BLOCK):
            cars = self.drivers.env_method("demonstrate", min(BLOCK, each - begun))
            yield from chain.from_iterable(zip(*cars, strict=True))

    def load_weights(self, policy: nn.Module, planner: DiffusionPlanner | None) -> None:
        """Let the cars drive with the policy, and plan with the planner, as they are now."""
        denoiser = None if planner is None else _arrays(planner.denoiser)
        self.drivers.env_method("load_weights", _arrays(policy), denoiser)

    def drive(self, steps: int) -> list[tuple[DrivenStep, ...]]:
        """So many steps of the policy, each of every car."""
        return list(zip(*self.drivers.env_method("drive", steps), strict=True))

    def seen(self) -> dict[str, NDArray[Any]]:
        """What the cars see now, batched."""
        cars = self.drivers.env_method("seen")
        return {key: np.stack([seen[key] for seen in cars]) for key in cars[0]}


def _arrays(network: nn.Module) -> dict[str, NDArray[Any]]:
    return {name: values.numpy() for name, values in network.state_dict().items()}
