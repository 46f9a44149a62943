"""Learning: imitation, reinforcement with a hybrid reward, and Algorithm 1 that joins them."""

from irl_dal.learning.collection.driver import Driver
from irl_dal.learning.collection.vec_driver import DriverProcesses
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.imitation.behaviour_cloning import CloningConfig
from irl_dal.learning.imitation.diffusion_training import DiffusionTrainingConfig
from irl_dal.learning.pipeline import Pipeline
from irl_dal.learning.progress import Observer, ProgressBar
from irl_dal.learning.reinforcement.discriminator import DiscriminatorConfig
from irl_dal.learning.reinforcement.hybrid_reward import HybridRewardConfig
from irl_dal.learning.reinforcement.policy import DrivingPolicy, build_policy
from irl_dal.learning.reinforcement.ppo import PPOConfig
from irl_dal.learning.reinforcement.rollout_buffer import HybridRolloutBuffer

__all__ = [
    "CloningConfig",
    "DiffusionTrainingConfig",
    "DiscriminatorConfig",
    "Driver",
    "DriverProcesses",
    "DrivingPolicy",
    "HybridRewardConfig",
    "HybridRolloutBuffer",
    "LearningConfig",
    "Observer",
    "PPOConfig",
    "Pipeline",
    "ProgressBar",
    "build_policy",
]
