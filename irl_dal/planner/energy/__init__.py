"""The energies that guide a plan; lower is better."""

from irl_dal.planner.energy.base import Energy, PlanBatch
from irl_dal.planner.energy.clearance import ClearanceEnergy, PrintedClearanceEnergy
from irl_dal.planner.energy.config import EnergyConfig, EnergyForms
from irl_dal.planner.energy.lane import LaneEnergy, PrintedLaneEnergy
from irl_dal.planner.energy.smoothness import ExpertEnergy, JerkEnergy, StabilityEnergy
from irl_dal.planner.energy.total import TotalEnergy

__all__ = [
    "ClearanceEnergy",
    "Energy",
    "EnergyConfig",
    "EnergyForms",
    "ExpertEnergy",
    "JerkEnergy",
    "LaneEnergy",
    "PlanBatch",
    "PrintedClearanceEnergy",
    "PrintedLaneEnergy",
    "StabilityEnergy",
    "TotalEnergy",
]
