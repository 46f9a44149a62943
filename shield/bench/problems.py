"""Random problems: nominal horizons (count, H, 2) and previous commands (count, 2)."""

import numpy as np

from shield.errors import Array
from shield.limits.actuator_limits import ActuatorLimits

__all__ = ["bending_problems", "random_problems"]


def random_problems(
    limits: ActuatorLimits, horizon: int, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw horizons of four kinds in equal shares, each from an admissible previous command.

    They are: far outside the box, inside the box without any smoothness, a random walk from the
    previous command, and a constant target with noise.
    """
    low, high = limits.low, limits.high
    previous = _admissible_commands(limits, count, rng)
    nominals = np.empty((count, horizon, 2))
    shape = (horizon, 2)
    for index in range(count):
        kind = index % 4
        if kind == 0:
            nominals[index] = rng.uniform(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low, shape)
        elif kind == 1:
            nominals[index] = rng.uniform(low, high, shape)
        elif kind == 2:
            walk = rng.normal(0.0, [0.05, 0.5], shape)
            nominals[index] = previous[index] + np.cumsum(walk, axis=0)
        else:
            nominals[index] = rng.uniform(low, high) + rng.normal(0.0, [0.02, 0.2], shape)
    return nominals, previous


def bending_problems(
    limits: ActuatorLimits, horizon: int, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw horizons that steer further into a bend at speed, so that the lateral bound binds."""
    previous = _admissible_commands(limits, count, rng)
    drift = np.array([0.5, 0.3]) * limits.max_increase * np.where(previous < 0.0, -1.0, 1.0)
    steps = rng.normal(drift[:, None, :], limits.max_increase, (count, horizon, 2))
    return previous[:, None, :] + np.cumsum(steps, axis=1), previous


def _admissible_commands(limits: ActuatorLimits, count: int, rng: np.random.Generator) -> Array:
    commands: list[Array] = []
    while len(commands) < count:
        command = rng.uniform(limits.low, limits.high)
        if limits.is_admissible(command):
            commands.append(command)
    return np.array(commands)
