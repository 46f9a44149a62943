"""The cars that a run trains on, as environments for stable-baselines3.

An episode is drawn from the run's seed and the episode's own number: its place, its traffic, its
disturbances and the planner's noise. Which process it is driven in, and beside what, makes no
difference to it. Wherever the cars are, they drive the same steps, and come in the same order.
"""

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv

from expert.modes import Mode
from expert.replay import Transition
from irl_dal.learning.collection.recorder import Counts, EpisodeEnd, StepRecord
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.imitation.disturbance import Disturbance
from irl_dal.loop import ControlLoop, Observation
from shield import Status

# [steps] of a demonstration that each car drives before it waits for the others: slow and fast ones
# even out, and four cars are done when the next planner update is due (Table II: every 500 steps).
BLOCK = 125


class Driver(gymnasium.Env[Observation, NDArray[Any]]):
    """Drives one car, its episodes one after another.

    The episodes of a run are numbered consecutively; this car drives numbers `place`,
    `place + n_envs`, and so on. Their seeds begin at `first_seed`, so that evaluations with smaller
    seeds drive where training never was.

    Args:
        loop: The control loop; its planner, if it has one, is this car's own.
        config: Number of cars, seeds and disturbances.
        seeds: The run's: each episode's random numbers are drawn from a child of it.
        place: Which of the cars this is.
    """

    def __init__(
        self, loop: ControlLoop, config: LearningConfig, seeds: np.random.SeedSequence, place: int
    ) -> None:
        self.observation_space, self.action_space = loop.observation_space, loop.action_space
        self.loop = loop
        self._config = config
        self._seeds = seeds
        self.begin_at(place)

    def begin_at(self, episode: int) -> None:
        """Number of the episode that begins next."""
        self._next, self._under_way = episode, False

    def load_planner(self, weights: Mapping[str, NDArray[np.float32]]) -> None:
        """Plan with these weights from now on."""
        planner = self.loop.supervision.planner
        assert planner is not None, "only a run with a planner trains it"
        planner.load_state_dict({name: torch.from_numpy(w) for name, w in weights.items()})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next episode, in a place of its own or in the one of a given seed."""
        self._episode, self._next = self._next, self._next + self._config.n_envs
        key = (*self._seeds.spawn_key, self._episode)
        rng = np.random.default_rng(np.random.SeedSequence(self._seeds.entropy, spawn_key=key))
        drawn = int(rng.integers(self._config.first_seed, 2**31))
        self._disturbance = Disturbance(rng, self._config.disturbance_rate)
        self._observation, self._info = self.loop.reset(
            seed=drawn if seed is None else seed, options=options
        )
        self._step, self._return, self._under_way = 0, 0.0, True
        return self._observation, {}

    def step(
        self, action: NDArray[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, StepRecord]]:
        """Drive one step with the policy's normalised action (2,); `info["record"]` tells of it."""
        error = np.abs(np.clip(action, -1.0, 1.0) - self._info["expert_action"]).mean() / 2.0
        record = self._record(self.loop.step(action), disagreement=float(error))
        driven, truncated = record.transition, record.end is EpisodeEnd.TIME_LIMIT
        return self._observation, driven.reward, driven.terminated, truncated, {"record": record}

    def demonstrate(self, steps: int) -> list[StepRecord]:
        """Let the expert go on for some steps, into new episodes where one ends.

        Commands of a disturbed step are not part of a demonstration.
        """
        records = []
        for _ in range(steps):
            if not self._under_way:
                self.reset()
            offset = self._disturbance.step()
            records.append(self._record(self.loop.step_expert(offset), expert_drove=offset is None))
        return records

    def close(self) -> None:
        """Close the simulator."""
        self.loop.close()

    def _record(
        self,
        result: tuple[Observation, float, bool, bool, dict[str, Any]],
        *,
        expert_drove: bool = False,
        disagreement: float = 0.0,
    ) -> StepRecord:
        """Join the state acted upon with what the loop returned."""
        observation, reward, terminated, truncated, info = result
        end = EpisodeEnd.TIME_LIMIT if truncated else EpisodeEnd.GOES_ON
        if terminated:
            end = EpisodeEnd.SUCCESS if info["success"] else EpisodeEnd.FAILURE
        transition = Transition(
            image=self._observation["image"],
            lidar=self._observation["lidar"],
            speed=self._observation["speed"],
            context=self._observation["context"],
            label=np.asarray(self._info["expert_action"], np.float32),
            command=np.asarray(info["executed_action"], np.float32),
            mode=Mode(self._info["mode"]),
            episode=self._episode,
            step=self._step,
            reward=reward,
            terminated=terminated,
            intervened=bool(info["triggered"]),
            expert_drove=expert_drove,
        )
        self._return += reward
        counts = self._counts(reward, info, end, disagreement)
        self._observation, self._info = observation, info
        self._step += 1
        self._under_way = end is EpisodeEnd.GOES_ON
        return StepRecord(transition, end, counts, self._return)

    def _counts(
        self, reward: float, info: dict[str, Any], end: EpisodeEnd, disagreement: float
    ) -> Counts:
        plan, certificate = info["plan"], info["certificate"]
        commands = info["executed_command"], info["previous_command"]
        over = end is not EpisodeEnd.GOES_ON
        changed = plan is not None and plan.status in (Status.PROJECTED, Status.REPAIRED)
        return Counts(
            steps=1,
            episodes=int(over),
            successes=int(end is EpisodeEnd.SUCCESS),
            collisions=int(over and bool(info["collision"])),
            triggers=int(info["triggered"]),
            plans_projected=int(changed),
            plan_fallbacks=int(plan is not None and plan.status is Status.FALLBACK),
            shield_corrections=int(certificate is not None and certificate.intervened),
            command_violations=int(self.loop.limits.violated(*commands)),
            reward=reward,
            disagreement=disagreement,
        )


class DriverProcesses(SubprocVecEnv):
    """stable-baselines3's cars in processes, which can be closed at any moment.

    After Ctrl-C some cars have answered and others have not, and stable-baselines3 would wait for
    answers that it has already. Nothing in these processes needs an orderly end.
    """

    def close(self) -> None:
        """End the processes, whatever they do."""
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.join()
        self.closed = True


def demonstrations(cars: VecEnv, steps: int) -> Iterator[StepRecord]:
    """At least so many steps of the expert, of all cars together, the cars in turn.

    The expert drives the same whatever was learnt, so cars need not wait for the learners.
    """
    each = -(-steps // cars.num_envs)
    for begun in range(0, each, BLOCK):
        records = cars.env_method("demonstrate", min(BLOCK, each - begun))
        yield from chain.from_iterable(zip(*records, strict=True))
