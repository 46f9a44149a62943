"""Many horizons at once: the algorithms of the package written over arrays.

Arrays carry the batch on their last axis, (H, 2, B), so that every operation of a step runs over
contiguous memory.
"""

from shield.projection.batch.engine import BatchEngine, BatchOutcome

__all__ = ["BatchEngine", "BatchOutcome"]
