"""The expert: a finite-state machine with classical controllers, and the replay it fills."""

from expert.fsm import ExpertConfig, ExpertDecision, FSMExpert
from expert.lane_map import LaneMap
from expert.modes import Mode

__all__ = [
    "ExpertConfig",
    "ExpertDecision",
    "FSMExpert",
    "LaneMap",
    "Mode",
]
