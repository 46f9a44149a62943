"""Learning: imitation, reinforcement with a hybrid reward, and Algorithm 1 that joins them."""

from irl_dal.learning.collection.driver import Driver, DriverProcesses
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.pipeline import Pipeline
from irl_dal.learning.reinforcement.policy import DrivingPolicy, build_policy
from irl_dal.learning.run_log import ProgressBar

__all__ = [
    "Driver",
    "DriverProcesses",
    "DrivingPolicy",
    "LearningConfig",
    "Pipeline",
    "ProgressBar",
    "build_policy",
]
