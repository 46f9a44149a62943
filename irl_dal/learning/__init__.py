"""Learning: imitation, reinforcement with a hybrid reward, and Algorithm 1 that joins them."""

from irl_dal.learning.collection.driver import Driver
from irl_dal.learning.collection.processes import DriverProcesses
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.imitation.behaviour_cloning import (
    BehaviourCloning,
    CloningConfig,
    CloningLoss,
)
from irl_dal.learning.imitation.diffusion_training import DiffusionTraining, DiffusionTrainingConfig
from irl_dal.learning.imitation.experience_correction import ExperienceCorrection
from irl_dal.learning.pipeline import Pipeline
from irl_dal.learning.progress import Observer, ProgressBar
from irl_dal.learning.reinforcement.discriminator import Discriminator, DiscriminatorConfig
from irl_dal.learning.reinforcement.hybrid_reward import HybridReward, HybridRewardConfig
from irl_dal.learning.reinforcement.policy import DrivingPolicy, PPOConfig, build_policy
from irl_dal.learning.reinforcement.rollout_buffer import HybridRolloutBuffer

__all__ = [
    "BehaviourCloning",
    "CloningConfig",
    "CloningLoss",
    "DiffusionTraining",
    "DiffusionTrainingConfig",
    "Discriminator",
    "DiscriminatorConfig",
    "Driver",
    "DriverProcesses",
    "DrivingPolicy",
    "ExperienceCorrection",
    "HybridReward",
    "HybridRewardConfig",
    "HybridRolloutBuffer",
    "LearningConfig",
    "Observer",
    "PPOConfig",
    "Pipeline",
    "ProgressBar",
    "build_policy",
]
