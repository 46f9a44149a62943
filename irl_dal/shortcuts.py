"""Short cuts that depend on the processor, the C library or a compiler: all of them, in one place.

Each stays only while it pays a tenth of a default training or of a plan. Results agree with and
without it to rounding, not to the last bit, so a run folder records which were in use
(`run.json`, key `shortcuts`).

| short cut  | where             | pays: how much longer a plan takes without it              |
|------------|-------------------|------------------------------------------------------------|
| `compiled` | energies, adjoints | 2.1 times in numpy                                        |
| `compiled` | network of a plan  | 1.5 times in numpy, 2.5 in traced torch, 4.3 in plain torch |
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

__all__ = ["compiled", "in_use"]

Function = TypeVar("Function", bound=Callable[..., object])

FAST_MATH = frozenset({"contract", "reassoc"})
"""Freedoms that vector instructions need: to fuse products into sums and to reorder sums. Neither
of them assumes that a number is finite."""


def compiled(function: Function) -> Function:
    """The same function as machine code, for numbers, arrays and named tuples of them.

    Numbers follow numpy's rules: a division by zero gives an infinity, not an exception. The
    machine code is kept beside the source, or in the user's cache folder, or in `NUMBA_CACHE_DIR`.
    Where none of them can be written, every process compiles anew (half a minute).
    """

    def decorate(*, cache: bool) -> Function:
        decorator = njit(cache=cache, error_model="numpy", fastmath=set(FAST_MATH))
        return cast(Function, decorator(function))

    try:
        return decorate(cache=True)
    except RuntimeError:  # Numba's answer to having no folder for its cache
        return decorate(cache=False)


def in_use() -> dict[str, bool]:
    """Name of each short cut, and whether this process takes it."""
    return {"compiled": True}
