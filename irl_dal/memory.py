"""What becomes of memory that was freed."""

from __future__ import annotations

import ctypes

__all__ = ["keep_freed_memory"]

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's mallopt(3)."""

LARGEST_MAPPING = 32 << 20
"""Largest M_MMAP_THRESHOLD that glibc takes [bytes]."""

KEPT = 1 << 30
"""Free memory that is kept [bytes]."""


def keep_freed_memory() -> bool:
    """Keep what is freed for the next gradient step, instead of handing it back to the system.

    The activations of a gradient step are arrays of megabytes. glibc returns them when the step
    ends, and in the next one the system maps and clears every page anew: a fifth of a cloning step.
    Holds for the rest of the process.

    Returns:
        Whether the C library could be told (glibc's can).
    """
    set_option = getattr(ctypes.pythonapi, "mallopt", None)
    if set_option is None:
        return False
    # One of the two alone switches off glibc's own adjustment and makes matters worse.
    return bool(
        set_option(M_MMAP_THRESHOLD, LARGEST_MAPPING) and set_option(M_TRIM_THRESHOLD, KEPT)
    )
