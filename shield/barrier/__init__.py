"""Bounds on the next command that come from what is around the car."""

from shield.barrier.obstacles import BarrierConfig, ObstacleBarrier

__all__ = ["BarrierConfig", "ObstacleBarrier"]
