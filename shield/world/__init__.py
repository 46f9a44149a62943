"""What is around the car."""

from shield.world.corridor import Corridor
from shield.world.world import Kind, Obstacles, World

__all__ = ["Corridor", "Kind", "Obstacles", "World"]
