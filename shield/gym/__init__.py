"""The shield around a gymnasium environment."""

from shield.gym.environment import ShieldedEnv, ShieldedVectorEnv

__all__ = ["ShieldedEnv", "ShieldedVectorEnv"]
