"""An environment that remembers, and rates of what it was given."""

from fractions import Fraction
from typing import Any

import gymnasium
import numpy as np

from shield.gym import ShieldedEnv

RATE, DT = 7.3, 0.05


class Recorder(gymnasium.Env[np.ndarray, np.ndarray]):
    """An environment that remembers the actions it was given.

    Args:
        space: Its action space.
        length: Steps in an episode.
    """

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, space: gymnasium.spaces.Space[Any], length: int = 1000) -> None:
        self.action_space = space
        self.actions: list[Any] = []
        self._length = length

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Forget the actions."""
        super().reset(seed=seed)
        self.actions = []
        return np.zeros(1, np.float32), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Remember an action."""
        self.actions.append(action)
        done = len(self.actions) >= self._length
        return np.zeros(1, np.float32), 0.0, done, False, {"own": 1}


def unit_box(dtype: Any = np.float32) -> gymnasium.spaces.Box:
    """Return the normalised action space of a car."""
    return gymnasium.spaces.Box(-1.0, 1.0, (2,), dtype)


def assert_rates(actions: list[np.ndarray], low: float, high: float, step: float) -> None:
    """Box and rate hold exactly from rest at zero."""
    last = Fraction(0)
    for action in actions:
        value = Fraction(float(action[0]))
        assert Fraction(low) <= value <= Fraction(high)
        assert abs(value - last) <= Fraction(step)
        last = value


def vector_of_recorders(mode: gymnasium.vector.AutoresetMode) -> tuple[Any, list[Recorder]]:
    """Two of them behind a rate of 0.25 per step, with episodes of 3 and 5 steps."""
    recorders = [Recorder(gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32), n) for n in (3, 5)]
    vector = gymnasium.vector.SyncVectorEnv(
        [lambda one=one: one for one in recorders], autoreset_mode=mode
    )
    return ShieldedEnv(vector, rate=0.25), recorders
