"""Bounds on the next command that come from what is around the car."""

from shield.world.barrier import BarrierConfig, ObstacleBarrier

__all__ = ["BarrierConfig", "ObstacleBarrier"]
