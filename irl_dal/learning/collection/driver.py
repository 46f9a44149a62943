"""One of the cars that a run trains on: drives, and says of every step what is to be known of it.

A car drives a stretch of steps at a time, with a policy and a planner of its own whose weights it
is given before: cars in processes of their own then wait for each other once a stretch and not in
every step.

An episode is drawn from the run's seed and the episode's own number: its place, its traffic, its
disturbances and the noise of policy and planner. Which process it is driven in, and beside what,
makes no difference to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from expert.modes import Mode
from expert.replay import Transition
from irl_dal.learning.collection.counts import Counts
from irl_dal.learning.collection.step_record import Draw, DrivenStep, End
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.imitation.disturbance import Disturbance
from irl_dal.learning.reinforcement.policy import DrivingPolicy
from irl_dal.loop import ControlLoop, Observation
from shield import Status

__all__ = ["Driver"]

Weights = Mapping[str, NDArray[np.float32]]


class Driver(gymnasium.Env[Observation, NDArray[Any]]):
    """Drives one car, its episodes one after another.

    An environment for the sake of its spaces and of stable-baselines3's processes; it is driven by
    `demonstrate` and `drive`.

    The episodes of a run are numbered through; this car drives numbers `place`, `place + n_envs`,
    and so on. Their seeds begin at `first_seed`, so that evaluations with smaller seeds drive where
    training never was.

    Args:
        loop: The control loop; its planner, if it has one, is this car's own.
        policy: This car's own; explores with noise of its own.
        config: Number of cars, seeds and disturbances.
        seeds: The run's: each episode's random numbers are drawn from a child of it.
        place: Which of the cars this is.
    """

    def __init__(
        self,
        loop: ControlLoop,
        policy: DrivingPolicy,
        config: LearningConfig,
        seeds: np.random.SeedSequence,
        place: int,
    ) -> None:
        self.observation_space, self.action_space = loop.observation_space, loop.action_space
        self.loop = loop
        self.policy = policy
        self.policy.generator = torch.Generator(policy.device)
        self.policy.set_training_mode(False)
        self._config = config
        self._seeds = seeds
        self._next = place
        self._under_way = False

    def begin_at(self, episode: int) -> None:
        """Number of the episode that begins next."""
        self._next, self._under_way = episode, False

    def load_weights(self, policy: Weights, planner: Weights | None = None) -> None:
        """Drive with these from now on, planning with the second if there is a planner."""
        self.policy.load_state_dict(_tensors(policy))
        if planner is not None:
            own = self.loop.supervision.planner
            assert own is not None, "only a run with a planner trains one"
            own.load_state_dict(_tensors(planner))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next episode, in a place of its own or in the one of a given seed."""
        self._episode, self._next = self._next, self._next + self._config.n_envs
        key = (*self._seeds.spawn_key, self._episode)
        rng = np.random.default_rng(np.random.SeedSequence(self._seeds.entropy, spawn_key=key))
        drawn = int(rng.integers(self._config.first_seed, 2**31))
        planner = self.loop.supervision.planner
        if planner is not None:
            planner.generator.manual_seed(int(rng.integers(2**63)))
        assert self.policy.generator is not None
        self.policy.generator.manual_seed(int(rng.integers(2**63)))
        self._disturbance = Disturbance(self._config.disturbance, rng)
        self._observation, self._info = self.loop.reset(
            seed=drawn if seed is None else seed, options=options
        )
        self._step, self._return, self._under_way = 0, 0.0, True
        return self._observation, {}

    def demonstrate(self, steps: int) -> list[DrivenStep]:
        """Let the expert go on for some steps, into new episodes where one ends."""
        return self._go_on(steps, self.expert_step)

    def drive(self, steps: int) -> list[DrivenStep]:
        """Let the policy go on for some steps, exploring, into new episodes where one ends."""
        return self._go_on(steps, self._explore)

    def seen(self) -> Observation:
        """What the car sees now, after its newest step."""
        return self._observation

    def expert_step(self) -> DrivenStep:
        """One step with the expert's command; a disturbed one is not part of a demonstration."""
        offset = self._disturbance.step()
        return self._told(self.loop.step_expert(offset), expert_drove=offset is None)

    def policy_step(self, action: NDArray[Any]) -> DrivenStep:
        """One step with a policy's normalised action (2,)."""
        error = np.abs(np.clip(action, -1.0, 1.0) - self._info["expert_action"]).mean() / 2.0
        return self._told(self.loop.step(action), disagreement=float(error))

    def close(self) -> None:
        """Give the simulator back."""
        self.loop.close()

    def _go_on(self, steps: int, step: Callable[[], DrivenStep]) -> list[DrivenStep]:
        driven = []
        for _ in range(steps):
            if not self._under_way:
                self.reset()
            driven.append(step())
        return driven

    @torch.no_grad()
    def _explore(self) -> DrivenStep:
        seen, _ = self.policy.obs_to_tensor(dict(self._observation))
        action, value, log_prob = self.policy(seen)
        draw = Draw(action[0].numpy(), float(value), float(log_prob))
        driven = self.policy_step(np.clip(draw.action, -1.0, 1.0))
        if driven.end is End.TIME_LIMIT:
            last, _ = self.policy.obs_to_tensor(dict(self._observation))
            draw = replace(draw, last_value=float(self.policy.predict_values(last)))
        return replace(driven, draw=draw)

    def _told(
        self,
        result: tuple[Observation, float, bool, bool, dict[str, Any]],
        *,
        expert_drove: bool = False,
        disagreement: float = 0.0,
    ) -> DrivenStep:
        """All that is to be known of the loop's step."""
        observation, reward, terminated, truncated, info = result
        end = End.of(terminated, truncated, success=bool(info["success"]))
        transition = Transition(
            image=self._observation["image"],
            lidar=self._observation["lidar"],
            speed=self._observation["speed"],
            context=self._info["context"].encode(),
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
        self._under_way = end is End.GOES_ON
        return DrivenStep(transition, end, counts, self._return)

    def _counts(self, reward: float, info: dict[str, Any], end: End, disagreement: float) -> Counts:
        plan, certificate = info["plan"], info["certificate"]
        commands = info["executed_command"], info["previous_command"]
        changed = plan is not None and plan.status in (Status.PROJECTED, Status.REPAIRED)
        return Counts(
            steps=1,
            episodes=int(end is not End.GOES_ON),
            successes=int(end is End.SUCCESS),
            collisions=int(end is not End.GOES_ON and bool(info["collision"])),
            triggers=int(info["triggered"]),
            plans_projected=int(changed),
            plan_fallbacks=int(plan is not None and plan.status is Status.FALLBACK),
            shield_corrections=int(certificate is not None and certificate.intervened),
            command_violations=int(self.loop.limits.violated(*commands)),
            policy_violations=int(info["nominal_violations"].get("policy", False)),
            reward=reward,
            disagreement=disagreement,
        )


def _tensors(weights: Weights) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(values) for name, values in weights.items()}
