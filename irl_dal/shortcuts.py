"""Short cuts that depend on the processor, the C library or a compiler: all of them, in one place.

Each stays only while it pays a tenth of a default training or of a plan. Results agree with and
without it to rounding, not to the last bit, so a run folder records which were in use
(`run.json`, key `shortcuts`).

| short cut  | where              | pays: how much longer it takes without                      |
|------------|--------------------|-------------------------------------------------------------|
| `compiled` | energies, adjoints | 2.1 times in numpy                                          |
| `compiled` | network of a plan  | 1.5 times in numpy, 2.5 in traced torch, 4.3 in plain torch |
| `bfloat16` | gradient steps     | 1.3 times: 57 against 43 ms of a cloning step (one thread)  |
| `mallopt`  | gradient steps     | 1.4 times: 58 against 43 ms of a cloning step (one thread)  |
"""

import ctypes
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeVar, cast

import torch
from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])

# Freedoms that vector instructions need: to fuse products into sums and to reorder sums. Neither of
# them assumes that a number is finite.
FAST_MATH = frozenset({"contract", "reassoc"})
# Names of the capabilities with which a processor multiplies bfloat16 numbers itself
NATIVE_BFLOAT16 = ("avx512_bf16", "amx_bf16", "bf16")
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # Parameters of glibc's mallopt(3)
LARGEST_MAPPING = 32 << 20  # Largest M_MMAP_THRESHOLD that glibc takes [bytes]
KEPT = 1 << 30  # Free memory that is kept [bytes]: more than a gradient step uses


def compiled(function: Function) -> Function:
    """The same function as machine code, for numbers, arrays and named tuples of them.

    Numbers follow numpy's rules: a division by zero gives an infinity, not an exception. The
    machine code is kept beside the source, or in the user's cache folder, or in `NUMBA_CACHE_DIR`.
    Where none of them can be written, every process compiles anew (half a minute).
    """
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": set(FAST_MATH)}
    try:
        return cast(Function, njit(cache=True, **options)(function))
    except RuntimeError:  # Numba's answer to having no folder for its cache
        return cast(Function, njit(cache=False, **options)(function))


def reduced_precision() -> AbstractContextManager[None]:
    """Multiply in bfloat16 meanwhile, where the processor does so itself.

    Weights, gradients and losses keep their 32 bits; matrix products and convolutions round their
    factors to 8 bits of mantissa, an error far below that of any prediction here.
    """
    return torch.autocast("cpu", torch.bfloat16, enabled=_multiplies_bfloat16())


def keep_freed_memory() -> bool:
    """Keep what is freed for the next gradient step, instead of handing it back to the system.

    The activations of a gradient step are arrays of megabytes. glibc returns them when the step
    ends, and in the next one the system maps and clears every page anew. Holds for the rest of the
    process. False where the C library cannot be told (glibc's can).
    """
    set_option = getattr(ctypes.pythonapi, "mallopt", None)
    if set_option is None:
        return False
    # One of the two alone switches off glibc's own adjustment and makes matters worse.
    return bool(
        set_option(M_MMAP_THRESHOLD, LARGEST_MAPPING) and set_option(M_TRIM_THRESHOLD, KEPT)
    )


def in_use() -> dict[str, bool]:
    """Name of each short cut, and whether a training in this process takes it."""
    mallopt = hasattr(ctypes.pythonapi, "mallopt")
    return {"compiled": True, "bfloat16": _multiplies_bfloat16(), "mallopt": mallopt}


def _multiplies_bfloat16() -> bool:
    return any(map(torch.cpu.get_capabilities().get, NATIVE_BFLOAT16))
