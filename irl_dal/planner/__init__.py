"""The planner: guided and projected diffusion over action chunks."""

from irl_dal.planner.blend import ActionBlend, BlendConfig
from irl_dal.planner.config import Activation, PlannerConfig, SamplerKind
from irl_dal.planner.context import CONTEXT_SIZE, PlanningContext
from irl_dal.planner.denoiser import ConditionalUnet1d
from irl_dal.planner.energy import EnergyConfig, EnergyForms, TotalEnergy
from irl_dal.planner.guidance import Guidance, GuidanceConfig
from irl_dal.planner.noise_schedule import NoiseSchedule, ScheduleKind
from irl_dal.planner.plan import Plan
from irl_dal.planner.planner import DiffusionPlanner
from irl_dal.planner.projection import PROJECTION_MODES, PlanProjection, ProjectionMode
from irl_dal.planner.sampler import (
    Prediction,
    Refinement,
    Sampler,
    Transitions,
    ddim_transitions,
    ddpm_transitions,
)

__all__ = [
    "CONTEXT_SIZE",
    "PROJECTION_MODES",
    "ActionBlend",
    "Activation",
    "BlendConfig",
    "ConditionalUnet1d",
    "DiffusionPlanner",
    "EnergyConfig",
    "EnergyForms",
    "Guidance",
    "GuidanceConfig",
    "NoiseSchedule",
    "Plan",
    "PlanProjection",
    "PlannerConfig",
    "PlanningContext",
    "Prediction",
    "ProjectionMode",
    "Refinement",
    "Sampler",
    "SamplerKind",
    "ScheduleKind",
    "TotalEnergy",
    "Transitions",
    "ddim_transitions",
    "ddpm_transitions",
]
