"""Compilation of numerical functions that run thousands of times in a control step.

A loop over eight commands costs an interpreter microseconds and a processor nanoseconds. What the
planner does in every reverse step is therefore compiled by Numba, once: the machine code is kept
beside the source.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

__all__ = ["compiled"]

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """The same function as machine code, for numbers, arrays and named tuples of them.

    Numbers follow numpy's rules: a division by zero gives an infinity, not an exception. Sums may
    be taken in another order and products fused into them, so that loops use vector instructions.
    """
    fast = {"contract", "reassoc"}
    return cast(Function, njit(cache=True, error_model="numpy", fastmath=fast)(function))
