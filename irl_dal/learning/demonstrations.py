"""The expert's steps in phase 1, driven ahead of whoever learns from them.

The expert drives the same whatever has been learnt, so its cars need not wait for the learners.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain, islice

from stable_baselines3.common.vec_env import VecEnv

from irl_dal.learning.driver import DrivenStep
from irl_dal.learning.processes import DriverProcesses

__all__ = ["demonstrations", "in_processes"]

Blocks = Generator[list[list[DrivenStep]], None, None]
"""Lists of steps, one for each car."""

BLOCK = 250
"""Steps that a car drives at a time."""

AHEAD = 4
"""Blocks that may be under way or ready: the learners come in bursts of 1,000 steps (Table II)."""


def in_processes(drivers: VecEnv) -> bool:
    """Whether the cars have processes of their own."""
    return isinstance(drivers.unwrapped, DriverProcesses)


def demonstrations(drivers: VecEnv, steps: int) -> Generator[DrivenStep, None, None]:
    """So many steps of the expert, the cars in turn.

    Cars that have processes of their own drive ahead; those in this process drive when asked. The
    steps are the same. Whoever stops early closes the generator, and the cars come to rest.

    Args:
        drivers: A vector of `Driver`.
        steps: How many, of all cars together.
    """
    each = -(-steps // drivers.num_envs)
    sizes = [min(BLOCK, each - begun) for begun in range(0, each, BLOCK)]
    blocks = _ahead(drivers, sizes) if in_processes(drivers) else _asked(drivers, sizes)
    in_turn = chain.from_iterable(chain.from_iterable(zip(*block, strict=True)) for block in blocks)
    try:
        yield from islice(in_turn, steps)
    finally:
        blocks.close()


def _asked(drivers: VecEnv, sizes: list[int]) -> Blocks:
    for size in sizes:
        yield drivers.env_method("demonstrate", size)


def _ahead(drivers: VecEnv, sizes: list[int]) -> Blocks:
    background = ThreadPoolExecutor(1)
    waiting: deque[Future[list[list[DrivenStep]]]] = deque()
    to_ask = iter(sizes)
    try:
        while True:
            for size in islice(to_ask, AHEAD - len(waiting)):
                waiting.append(background.submit(drivers.env_method, "demonstrate", size))
            if not waiting:
                return
            yield waiting.popleft().result()
    finally:
        background.shutdown(cancel_futures=True)
