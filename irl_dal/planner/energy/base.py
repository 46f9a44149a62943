"""What an energy is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from irl_dal.planner.action_scale import ActionScale
from irl_dal.planner.context import PlanningContext
from irl_dal.planner.energy.config import EnergyConfig
from shield import ActuatorLimits

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PlanBatch:
    """Candidate plans in both units.

    Attributes:
        actions: Normalised (B, H, 2).
        commands: The same in (B, H, 2) [rad, m/s].
    """

    actions: Array
    commands: Array

    @classmethod
    def of(cls, actions: Array, scale: ActionScale) -> PlanBatch:
        """From normalised actions (B, H, 2), inside the box or outside."""
        return cls(actions, scale.to_command(actions))


class Energy(ABC):
    """One term of Eq. dal_energy for one planning context. Lower is better.

    Args:
        context: What is known now.
        config: Weights and scales.
        limits: Actuators; they give the units of an action.
        horizon: H of the plans.
    """

    name: ClassVar[str]

    def __init__(
        self, context: PlanningContext, config: EnergyConfig, limits: ActuatorLimits, horizon: int
    ) -> None:
        self.context = context
        self.config = config
        self.limits = limits
        self.horizon = horizon
        self.scale = ActionScale(limits)

    @property
    def active(self) -> bool:
        """Whether the term has anything to say in this context."""
        return True

    @abstractmethod
    def evaluate(self, plans: PlanBatch) -> tuple[Array, Array]:
        """Value and gradient.

        Args:
            plans: B candidates.

        Returns:
            Energies (B,) and their derivatives with respect to the normalised actions (B, H, 2).
        """

    def _per_action(self, per_command: Array) -> Array:
        """Turn derivatives with respect to commands (B, H, 2), in place, into those of actions."""
        per_command *= self.scale.half
        return per_command


class ConstantEnergy(Energy):
    """A term that ignores the plan, as two of the paper's do. Its gradient is zero."""

    @abstractmethod
    def constant(self) -> float:
        """The value, whatever the plan."""

    def evaluate(self, plans: PlanBatch) -> tuple[Array, Array]:
        """The constant (B,) and zeros (B, H, 2)."""
        return np.full(len(plans.actions), self.constant()), np.zeros_like(plans.actions)
