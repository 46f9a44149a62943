"""The cars of a training together, in one process or each in a process of its own.

Wherever they are, they drive the same steps, and come in the same order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv

from irl_dal.learning.collection.step_record import StepRecord
from irl_dal.planner import DiffusionPlanner

__all__ = ["DriverProcesses", "VecDriver"]

BLOCK = 250
"""Steps of a demonstration that each car drives before it waits for the others: slow and fast ones
even out, and two cars are done when the next planner update is due (Table II: every 500 steps)."""


class DriverProcesses(SubprocVecEnv):
    """stable-baselines3's cars in processes, which can be closed at any moment.

    After Ctrl-C some cars have answered and others have not, and stable-baselines3 would wait for
    answers that it has already. Nothing in these processes needs an orderly end.
    """

    def close(self) -> None:
        """End the processes, whatever they do."""
        if self.closed:
            return
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.join()
        self.closed = True


class VecDriver:
    """What the pipeline asks of all cars beside `VecEnv.step`.

    Args:
        cars: A vector of `Driver`.
    """

    def __init__(self, cars: VecEnv) -> None:
        self._cars = cars

    def begin_at(self, episodes: Sequence[int]) -> None:
        """Number of the episode that each car begins next."""
        for car, episode in enumerate(episodes):
            self._cars.env_method("begin_at", episode, indices=[car])

    def demonstrations(self, steps: int) -> Iterator[StepRecord]:
        """At least so many steps of the expert, of all cars together, the cars in turn.

        The expert drives the same whatever was learnt, so cars need not wait for the learners.
        """
        each = -(-steps // self._cars.num_envs)
        for begun in range(0, each, BLOCK):
            cars = self._cars.env_method("demonstrate", min(BLOCK, each - begun))
            yield from chain.from_iterable(zip(*cars, strict=True))

    def load_planner(self, planner: DiffusionPlanner | None) -> None:
        """Let the cars plan with a planner's weights as they are now; nothing without a planner."""
        if planner is not None:
            weights = {name: w.numpy() for name, w in planner.denoiser.state_dict().items()}
            self._cars.env_method("load_planner", weights)
