"""The trained U-Net in numpy, for planning one chunk at a time on a CPU.

Of a U-Net of this size a deep-learning library spends most of the time on the overhead of its
operators. Here activations are channels-last, every convolution is one matrix product over a
strided view, and what depends only on k and the context is computed once per plan for all k.
The arithmetic is that of `ConditionalUnet1d`, to single-precision rounding.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from torch import Tensor, nn

from irl_dal.planner.denoiser import (
    NORM_EPSILON,
    ConditionalUnet1d,
    ResidualBlock,
    check_context,
    embed_step,
)

Single = NDArray[np.float32]

Film = tuple[Single, Single]
"""1 + scale and shift of one block, each (S, B or 1, 1, C)."""


class _Convolution:
    """A length-3 or length-1 convolution as a matrix (3 * inputs, outputs) or (inputs, outputs).

    Zero padding keeps the length before the stride. The padded input and the view of its windows
    are kept for each shape, so an object serves one call at a time.
    """

    def __init__(self, layer: nn.Conv1d) -> None:
        assert layer.bias is not None
        self._weight = _array(layer.weight.permute(2, 1, 0).flatten(0, 1))
        self._bias = _array(layer.bias)
        self._stride = layer.stride[0]
        self._kernel = layer.kernel_size[0]
        self._buffers: dict[tuple[int, ...], tuple[Single, Single]] = {}

    def __call__(self, x: Single) -> Single:
        """Convolve (B, length, inputs) to (B, length / stride, outputs)."""
        batch, length, _ = x.shape
        if self._kernel == 1:
            rows = x.reshape(batch * length, -1)
        else:
            inside, windows = self._buffers.get(x.shape) or self._allocate(x.shape)
            inside[...] = x
            length //= self._stride
            rows = windows.reshape(batch * length, -1)
        product = rows @ self._weight
        product += self._bias
        return product.reshape(batch, length, -1)

    def _allocate(self, shape: tuple[int, ...]) -> tuple[Single, Single]:
        """The inside of a padded buffer and its windows (B, length / stride, 3 * inputs)."""
        batch, length, inputs = shape
        padded = np.zeros((batch, length + 2, inputs), np.float32)
        across, along, within = padded.strides
        windows = as_strided(
            padded,
            (batch, length // self._stride, self._kernel * inputs),
            (across, self._stride * along, within),
        )
        self._buffers[shape] = padded[:, 1:-1], windows
        return self._buffers[shape]


class _Block:
    """A `ResidualBlock`."""

    def __init__(self, block: ResidualBlock) -> None:
        self.first = _Convolution(block.first)
        self.second = _Convolution(block.second)
        self.gain = _array(block.gain)
        self.skip = None if block.skip is None else _Convolution(block.skip)

    def __call__(self, x: Single, film: Film, index: int) -> Single:
        """Evaluate on (B, length, inputs) with the FiLM terms of reverse step `index`."""
        hidden = self.first(x)
        _normalise(hidden)
        hidden *= film[0][index]
        hidden += film[1][index]
        _silu(hidden)
        hidden = self.second(hidden)
        _normalise(hidden)
        hidden *= self.gain
        _silu(hidden)
        hidden += x if self.skip is None else self.skip(x)
        return hidden


class FastDenoiser:
    """A snapshot of a U-Net's weights, ready for the reverse steps of one sampler.

    Args:
        network: The trained network; later changes of it are not seen.
        k: Diffusion steps of the sampler, (S,).
    """

    def __init__(self, network: ConditionalUnet1d, k: NDArray[np.int64]) -> None:
        self._network_of_context = _array(network.from_context.weight.T)
        with torch.no_grad():
            embedding = embed_step(torch.from_numpy(k.copy()), network.config.embedding)
            device = network.from_step.weight.device
            self._steps = _array(network.from_step(embedding.to(device)))  # (S, condition)
        self._context_bias = _array(network.from_context.bias)
        self._mix = _array(network.mix.weight.T), _array(network.mix.bias)
        self._film = _array(network.film.weight.T), _array(network.film.bias)
        self._channels = network.film_channels
        self._down, self._low = _Block(network.down), _Block(network.low)
        self._middle, self._up = _Block(network.middle), _Block(network.up)
        self._shrink, self._grow = _Convolution(network.shrink), _Convolution(network.grow)
        self._out = _Convolution(network.out)

    def condition(self, context: Single) -> tuple[Film, ...]:
        """FiLM terms of `down`, `low`, `middle` and `up` for all reverse steps.

        Args:
            context: (B, 64), or (1, 64) for a batch that shares it.

        Raises:
            ValueError: A context of another size.
        """
        check_context(context.shape)
        mixed = context @ self._network_of_context
        mixed += self._context_bias
        hidden = self._steps[:, None] + mixed  # (S, B, condition)
        with np.errstate(over="ignore"):
            for weight, bias in (self._mix, self._film):
                _silu(hidden)
                hidden = hidden.reshape(-1, hidden.shape[-1]) @ weight
                hidden += bias
        table = hidden.reshape(len(self._steps), len(context), 1, -1)
        films, start = [], 0
        for channels in self._channels:
            scale = table[..., start : start + channels] + np.float32(1.0)
            shift = np.ascontiguousarray(table[..., start + channels : start + 2 * channels])
            films.append((scale, shift))
            start += 2 * channels
        return tuple(films)

    def predict(self, noisy: NDArray[np.float64], films: tuple[Film, ...], index: int) -> Single:
        """The network's output (B, H, 2) for x_k (B, H, 2) of reverse step `index`."""
        down, low, middle, up = films
        with np.errstate(over="ignore"):
            full = self._down(noisy.astype(np.float32), down, index)
            half = self._low(self._shrink(full), low, index)
            half = self._middle(half, middle, index)
            doubled = self._grow(half).reshape(full.shape)
            joined = np.concatenate([doubled, full], axis=2)
            return self._out(self._up(joined, up, index))


def _array(tensor: Tensor) -> Single:
    """A contiguous single-precision copy that shares nothing with torch."""
    return np.array(tensor.detach().cpu().numpy(), dtype=np.float32, order="C")


def _normalise(x: Single) -> None:
    """`ChannelNorm`, in place, on (B, length, C)."""
    scale = np.vecdot(x, x)
    scale /= x.shape[2]
    scale += NORM_EPSILON
    np.sqrt(scale, out=scale)
    x /= scale[:, :, None]


def _silu(x: Single) -> None:
    """The activation x * sigmoid(x), in place; where exp(-x) overflows, x / inf is its limit."""
    divisor = np.exp(np.negative(x))
    divisor += 1.0
    x /= divisor
