"""The energies that guide a plan; lower is better."""

from irl_dal.planner.energy.config import EnergyConfig
from irl_dal.planner.energy.total import TotalEnergy

__all__ = ["EnergyConfig", "TotalEnergy"]
