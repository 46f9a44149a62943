"""What an energy is."""

from abc import ABC, abstractmethod
from typing import ClassVar

from irl_dal.planner.action_scale import ActionScale
from irl_dal.planner.arrays import Array
from irl_dal.planner.context import PlanningContext
from irl_dal.planner.energy.config import EnergyConfig
from shield import ActuatorLimits


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
    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2) of normalised actions (B, H, 2)."""

    def _per_action(self, per_command: Array) -> Array:
        """Turn derivatives with respect to commands (B, H, 2), in place, into those of actions."""
        per_command *= self.scale.half
        return per_command
