"""What an energy is."""

from abc import ABC, abstractmethod
from typing import ClassVar

from irl_dal.arrays import Array
from irl_dal.planner.action_scale import ActionScale
from irl_dal.planner.context import PlanningContext
from irl_dal.planner.energy.config import EnergyConfig
from shield import ActuatorLimits


class Energy(ABC):
    """One term of Eq. dal_energy for one planning context, for plans of H = `horizon`."""

    name: ClassVar[str]
    weight: float  # Of the term in this context

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
        return self.weight > 0

    @abstractmethod
    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2) of normalised actions (B, H, 2)."""
