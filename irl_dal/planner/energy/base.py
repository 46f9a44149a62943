"""What an energy is."""

from abc import ABC, abstractmethod

from irl_dal.arrays import Array
from irl_dal.planner.action_scale import ActionScale
from irl_dal.planner.context import PlanningContext, hazard
from irl_dal.planner.energy.config import EnergyConfig
from shield import ActuatorLimits


class Energy(ABC):
    """One term of Eq. dal_energy for one planning context, for plans of H = `horizon`."""

    weight: float  # Of the term in this context, set by `prepare`

    def __init__(
        self, context: PlanningContext, config: EnergyConfig, limits: ActuatorLimits, horizon: int
    ) -> None:
        self.context = context
        self.config = config
        self.limits = limits
        self.horizon = horizon
        self.scale = ActionScale(limits)
        self.prepare()

    @abstractmethod
    def prepare(self) -> None:
        """Set the weight and what does not depend on the actions."""

    @property
    def active(self) -> bool:
        """Whether the term has anything to say in this context."""
        return self.weight > 0

    @abstractmethod
    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2) of normalised actions (B, H, 2)."""


def risk_adaptive(weight: float, context: PlanningContext) -> float:
    """The paper's w_lane and w_lidar of a base weight."""
    return weight * (1.0 + hazard(context.nearest))
