"""Learning: imitation, reinforcement with a hybrid reward, and Algorithm 1 that joins them."""

from irl_dal.learning.collection.driver import Driver, DriverProcesses
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.pipeline import Pipeline
from irl_dal.learning.progress import ProgressBar
from irl_dal.learning.reinforcement.policy import DrivingPolicy, build_policy

__all__ = [
    "Driver",
    "DriverProcesses",
    "DrivingPolicy",
    "LearningConfig",
    "Pipeline",
    "ProgressBar",
    "build_policy",
]
