"""Perception: what the policy sees, with the learnable adaptive mask of the paper."""

from irl_dal.perception.adaptive_mask import LearnableAdaptiveMask
from irl_dal.perception.config import PerceptionConfig
from irl_dal.perception.encoder import DrivingFeaturesExtractor

__all__ = ["DrivingFeaturesExtractor", "LearnableAdaptiveMask", "PerceptionConfig"]
