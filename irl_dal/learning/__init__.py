"""Learning: imitation, reinforcement with a hybrid reward, and Algorithm 1 that joins them."""

from irl_dal.learning.behaviour_cloning import BehaviourCloning, CloningConfig, CloningLoss
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.diffusion_training import DiffusionTraining, DiffusionTrainingConfig
from irl_dal.learning.discriminator import Discriminator, DiscriminatorConfig
from irl_dal.learning.driver import Driver
from irl_dal.learning.experience_correction import ExperienceCorrection
from irl_dal.learning.hybrid_reward import HybridReward, HybridRewardConfig
from irl_dal.learning.pipeline import Pipeline
from irl_dal.learning.policy import DrivingPolicy, PPOConfig, build_policy
from irl_dal.learning.processes import DriverProcesses
from irl_dal.learning.progress import Observer, ProgressBar
from irl_dal.learning.rollout_buffer import HybridRolloutBuffer

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
