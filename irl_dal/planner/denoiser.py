"""The network of the planner: a 1-D U-Net over an action chunk, conditioned on k and the context.

Two levels, H and H/2 long. The condition enters every block as a scale and a shift per channel
(FiLM), all of them from one linear layer, so that they can be computed once per plan for all k.

References:
    Perez et al., FiLM: Visual Reasoning with a General Conditioning Layer, 2018.
    Chi et al., Diffusion Policy, 2023 (the architecture's family).
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from irl_dal.planner.context import CONTEXT_SIZE

ACTION_SIZE = 2
EMBEDDING = 64  # Size of the sinusoidal embedding of k; the paper does not give it
CONDITION = 128  # Size of the mixed condition: the embedding and the context, 64 numbers each
NORM_EPSILON = 1e-6  # Added to a mean square before its root: keeps a position of zeros at zero


class ResidualBlock(nn.Module):
    """Convolution, norm, FiLM, SiLU, convolution, norm, SiLU, plus the input."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first = nn.Conv1d(inputs, outputs, kernel_size=3, padding=1)
        self.second = nn.Conv1d(outputs, outputs, kernel_size=3, padding=1)
        self.gain = nn.Parameter(torch.ones(outputs))
        self.skip = nn.Conv1d(inputs, outputs, kernel_size=1) if inputs != outputs else None

    def forward(self, x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
        """Features (B, length, inputs), scale and shift (B, outputs), to (B, length, outputs)."""
        hidden = normalise(convolve(self.first, x)) * (1.0 + scale[:, None]) + shift[:, None]
        hidden = normalise(convolve(self.second, functional.silu(hidden))) * self.gain
        return functional.silu(hidden) + (x if self.skip is None else convolve(self.skip, x))


class ConditionalUnet1d(nn.Module):
    """Noisy chunk, diffusion step and context to the network's prediction.

    `width` channels at full length, even, and twice that at half length: 64 gives about 0.43 M
    parameters and 0.2 ms per evaluation.
    """

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        self._width = width
        self.from_step = nn.Linear(EMBEDDING, CONDITION)
        self.from_context = nn.Linear(CONTEXT_SIZE, CONDITION)
        self.mix = nn.Linear(CONDITION, CONDITION)
        self.down = ResidualBlock(ACTION_SIZE, width)
        self.shrink = nn.Conv1d(width, width, kernel_size=3, stride=2, padding=1)
        self.low = ResidualBlock(width, 2 * width)
        self.middle = ResidualBlock(2 * width, 2 * width)
        self.grow = nn.Conv1d(2 * width, 2 * width, kernel_size=3, padding=1)
        self.up = ResidualBlock(2 * width, width)
        self.out = nn.Conv1d(width, ACTION_SIZE, kernel_size=1)
        self.film = nn.Linear(CONDITION, 2 * sum(self.film_channels))

    @property
    def film_channels(self) -> tuple[int, int, int, int]:
        """Channels that FiLM drives in `down`, `low`, `middle` and `up`."""
        return (self._width, 2 * self._width, 2 * self._width, self._width)

    def condition(self, step_embedding: Tensor, context: Tensor) -> Tensor:
        """Scales and shifts (B, 2 * sum(film_channels)) of `down`, then of `low`, `middle`, `up`.

        Both arguments are (B, 64), or broadcast against each other.
        """
        hidden = functional.silu(self.from_step(step_embedding) + self.from_context(context))
        return self.film(functional.silu(self.mix(hidden)))

    def forward(self, noisy: Tensor, k: Tensor, context: Tensor) -> Tensor:
        """The clean chunk or the noise (B, H, 2), whichever it is trained for.

        Of chunks x_k (B, H, 2), H even, steps k (B,) and contexts (B, 64), else `ValueError`.
        """
        if noisy.shape[1] % 2:
            raise ValueError(f"`horizon` must be even, the U-Net halves it. Got {noisy.shape[1]}.")
        check_context(tuple(context.shape))
        film = self.condition(embed_step(k), context)
        terms = torch.split(film, [c for c in self.film_channels for _ in range(2)], dim=1)
        full = self.down(noisy, terms[0], terms[1])
        half = self.low(convolve(self.shrink, full), terms[2], terms[3])
        half = self.middle(half, terms[4], terms[5])
        # Two half-length channels become two neighbouring full-length positions.
        doubled = convolve(self.grow, half).reshape(full.shape)
        return convolve(self.out, self.up(torch.cat([doubled, full], dim=2), terms[6], terms[7]))


def convolve(layer: nn.Conv1d, x: Tensor) -> Tensor:
    """A convolution of (B, length, inputs) to (B, length / stride, outputs).

    As one matrix product: on so short sequences torch's own convolution takes half as long again.
    """
    (size,), (stride,), length = layer.kernel_size, layer.stride, x.shape[1]
    padded = functional.pad(x, (0, 0, size // 2, size // 2))
    taps = [padded[:, tap : tap + length : stride] for tap in range(size)]
    weight = layer.weight.transpose(1, 2).flatten(1)
    return functional.linear(torch.cat(taps, dim=2), weight, layer.bias)


def normalise(x: Tensor) -> Tensor:
    """Division of (B, length, C) by the root mean square over the channels of each position."""
    return x * torch.rsqrt(x.square().mean(dim=2, keepdim=True) + NORM_EPSILON)


def check_context(shape: tuple[int, ...]) -> None:
    """`ValueError` for contexts that are not (B, 64)."""
    if len(shape) != 2 or shape[1] != CONTEXT_SIZE:
        raise ValueError(f"`context` must have shape (B, {CONTEXT_SIZE}). Got {shape}.")


def embed_step(k: Tensor) -> Tensor:
    """Sinusoidal embedding of the diffusion steps k (B,): (B, `EMBEDDING`)."""
    half = EMBEDDING // 2
    frequency = torch.exp(-math.log(10_000.0) * torch.arange(half, device=k.device) / half)
    angle = k.to(frequency.dtype)[:, None] * frequency
    return torch.cat([angle.sin(), angle.cos()], dim=1)
