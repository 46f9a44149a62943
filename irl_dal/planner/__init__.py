"""The planner: guided and projected diffusion over action chunks."""

from irl_dal.planner.blend import BlendConfig
from irl_dal.planner.config import Activation, PlannerConfig
from irl_dal.planner.context import PlanningContext
from irl_dal.planner.energy import EnergyConfig, TotalEnergy
from irl_dal.planner.guidance import Guidance, GuidanceConfig
from irl_dal.planner.planner import DiffusionPlanner, Plan
from irl_dal.planner.projection import ProjectionMode
from irl_dal.planner.sampler import Refinement

__all__ = [
    "Activation",
    "BlendConfig",
    "DiffusionPlanner",
    "EnergyConfig",
    "Guidance",
    "GuidanceConfig",
    "Plan",
    "PlannerConfig",
    "PlanningContext",
    "ProjectionMode",
    "Refinement",
    "TotalEnergy",
]
