"""The expert's steps in phase 1, as one stream of all cars."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from stable_baselines3.common.vec_env import VecEnv

from irl_dal.learning.driven_step import DrivenStep

__all__ = ["demonstrations"]

BLOCK = 250
"""Steps that each car drives before it waits for the others: slow and fast ones even out, and two
cars are done when the next update is due (Table II)."""


def demonstrations(drivers: VecEnv, steps: int) -> Iterator[DrivenStep]:
    """At least so many steps of the expert, the cars in turn.

    The expert drives the same whatever has been learnt, so a car needs nothing from the learners
    or from other cars, and those that have processes of their own drive at the same time.

    Args:
        drivers: A vector of `Driver`.
        steps: How many, of all cars together.
    """
    each = -(-steps // drivers.num_envs)
    for begun in range(0, each, BLOCK):
        cars = drivers.env_method("demonstrate", min(BLOCK, each - begun))
        yield from chain.from_iterable(zip(*cars, strict=True))
