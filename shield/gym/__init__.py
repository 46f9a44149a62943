"""The shield around a gymnasium environment."""

from shield.gym.environment import ShieldedEnv, ShieldedVectorEnv
from shield.world.reading import Reading

__all__ = ["Reading", "ShieldedEnv", "ShieldedVectorEnv"]
