"""In which precision gradient steps multiply."""

from __future__ import annotations

from contextlib import AbstractContextManager

import torch

__all__ = ["reduced_precision"]

NATIVE = ("avx512_bf16", "amx_bf16", "bf16")
"""Names of the capabilities with which a processor multiplies bfloat16 numbers itself."""


def reduced_precision(device: torch.device, *, wanted: bool) -> AbstractContextManager[None]:
    """Multiply in bfloat16 meanwhile, where the processor does so faster.

    Weights, gradients and losses keep their 32 bits; matrix products and convolutions round their
    factors to 8 bits of mantissa, an error far below that of any prediction here.

    Args:
        device: Where the networks are.
        wanted: False leaves everything in single precision.
    """
    native = device.type != "cpu" or any(map(torch.cpu.get_capabilities().get, NATIVE))
    return torch.autocast(device.type, torch.bfloat16, enabled=wanted and native)
