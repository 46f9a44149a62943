"""Terms on the actions themselves: E_jerk, E_stability and E_expert."""

import math

import numpy as np

from irl_dal.arrays import Array
from irl_dal.planner.energy.base import Energy
from irl_dal.shortcuts import compiled


class JerkEnergy(Energy):
    r"""Control smoothness: :math:`w_{jerk}` times the mean of :math:`\|a_i - a_{i-1}\|^2`.

    The printed form averages i = 1 ... H - 1. The roll-out form also counts the step from the last
    executed command to the first action and averages over H.
    """

    def prepare(self) -> None:
        """Set the weight and the action before the first."""
        self.weight = self.config.jerk_weight
        self._previous = self.scale.to_action(self.context.previous)

    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2)."""
        first = 1 if self.config.forms == "printed" else 0
        return _steps(actions, self._previous, first, self.weight)


class StabilityEnergy(Energy):
    r"""Steady control: :math:`w_{stab}` times the mean of :math:`steer_i^2 + (v_i - v_{ref})^2`.

    In normalised units. The printed form is neutral at zero steering; the roll-out form at the
    steering that follows the lane's curvature.
    """

    def prepare(self) -> None:
        """Set the weight and the neutral action."""
        config, lane = self.config, self.context.lane
        self.weight = config.stability_weight
        speed, steering = max(float(self.context.previous[1]), config.slowest_reference), 0.0
        if config.forms == "rollout" and lane.valid:
            steering = math.atan(self.limits.wheelbase * lane.curvature)
        self._neutral = self.scale.to_action(np.array([steering, speed]))

    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2)."""
        return _distance(actions, self._neutral[None], self.weight)


class ExpertEnergy(Energy):
    r"""With a reference, :math:`w_{exp}` times the mean of :math:`\|a_i - a_i^{expert}\|^2`."""

    def prepare(self) -> None:
        """Set the weight, 0 without a reference."""
        reference = self.context.expert_reference
        self.weight = 0.0
        if reference is not None:
            self.weight = self.config.expert_weight
            self._reference = self.scale.to_action(reference)

    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2)."""
        return _distance(actions, self._reference, self.weight)


@compiled
def _steps(actions: Array, previous: Array, first: int, weight: float) -> tuple[Array, Array]:
    """`weight` times the mean squared step from `first` on, and its derivative (B, H, 2)."""
    batch, horizon, size = actions.shape
    factor = weight / (horizon - first)
    value, gradient = np.zeros(batch), np.zeros(actions.shape)
    for b in range(batch):
        for i in range(first, horizon):
            for c in range(size):
                before = actions[b, i - 1, c] if i else previous[c]
                step = actions[b, i, c] - before
                value[b] += factor * step * step
                gradient[b, i, c] += 2.0 * factor * step
                if i:
                    gradient[b, i - 1, c] -= 2.0 * factor * step
    return value, gradient


@compiled
def _distance(actions: Array, target: Array, weight: float) -> tuple[Array, Array]:
    """`weight` times the mean squared distance from (H or 1, 2), and its derivative (B, H, 2)."""
    batch, horizon, size = actions.shape
    factor = weight / horizon
    value, gradient = np.zeros(batch), np.empty(actions.shape)
    for b in range(batch):
        for i in range(horizon):
            for c in range(size):
                away = actions[b, i, c] - target[min(i, len(target) - 1), c]
                value[b] += factor * away * away
                gradient[b, i, c] = 2.0 * factor * away
    return value, gradient
