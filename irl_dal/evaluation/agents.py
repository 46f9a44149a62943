"""Who drives in an evaluation: a trained policy, the expert, or random actions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from irl_dal.evaluation.statistics import Array
from irl_dal.learning.reinforcement.policy import DrivingPolicy, mean_action
from irl_dal.loop import ControlLoop, Observation

StepResult = tuple[Observation, float, bool, bool, dict[str, Any]]


class Agent:
    """Chooses an action for every observation and drives it."""

    def reset(self, seed: int) -> None:
        """Begin an episode with this seed."""

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Array:
        """The agent's own action (2,), normalised, for an observation and the `info` with it."""
        raise NotImplementedError

    def drive(self, loop: ControlLoop, action: Array) -> StepResult:
        """Drive a step with an action of `act`, under planner and shield if the loop has them."""
        return loop.step(action)


@dataclass(slots=True)
class PolicyAgent(Agent):
    """A trained policy, without exploration."""

    policy: DrivingPolicy

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Array:
        """The policy's mean action (2,), clipped to the action space."""
        seen, _ = self.policy.obs_to_tensor(dict(observation))
        assert isinstance(seen, dict)
        with torch.inference_mode():
            action = mean_action(self.policy, seen)[0]
        return np.clip(action.cpu().numpy().astype(np.float64), -1.0, 1.0)


class ExpertAgent(Agent):
    """The expert itself; its action is its set-point."""

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Array:
        """The expert's label for this observation (2,)."""
        return np.asarray(info["expert_action"], np.float64)

    def drive(self, loop: ControlLoop, action: Array) -> StepResult:
        """With the expert's own set-point."""
        return loop.step_expert()


class RandomAgent(Agent):
    """Actions drawn uniformly from the action space."""

    def reset(self, seed: int) -> None:
        """The same seed draws the same actions."""
        self._rng = np.random.default_rng(seed)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Array:
        """An action (2,) from [-1, 1]^2."""
        return self._rng.uniform(-1.0, 1.0, 2)
