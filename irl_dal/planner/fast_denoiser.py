"""The trained U-Net compiled, for planning one chunk at a time on a CPU.

Of a U-Net of this size a deep-learning library spends most of the time on the overhead of its
operators. Here activations are channels-last, every convolution is one matrix product, norm, FiLM
and activation are one loop, and what depends only on k and the context is computed once per plan
for all k. The arithmetic is that of `ConditionalUnet1d`, to single-precision rounding.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from irl_dal.planner.denoiser import (
    NORM_EPSILON,
    ConditionalUnet1d,
    ResidualBlock,
    check_context,
    embed_step,
)
from irl_dal.shortcuts import compiled

Single = NDArray[np.float32]


class _Layer(NamedTuple):
    """A length-3 or length-1 convolution as a matrix (3 * inputs, outputs) or (inputs, outputs)."""

    weight: Single
    bias: Single


class _Block(NamedTuple):
    """A `ResidualBlock`; without a skip convolution that layer is empty."""

    first: _Layer
    second: _Layer
    gain: Single
    skip: _Layer


class _Unet(NamedTuple):
    """Everything in a `ConditionalUnet1d` that x_k passes through."""

    down: _Block
    shrink: _Layer
    low: _Block
    middle: _Block
    grow: _Layer
    up: _Block
    out: _Layer


class Film(NamedTuple):
    """1 + scale and shift of one block for all reverse steps, each (S, C)."""

    scale: Single
    shift: Single


class FastDenoiser:
    """A snapshot of a U-Net's weights, ready for the reverse steps k (S,) of one sampler."""

    def __init__(self, network: ConditionalUnet1d, k: NDArray[np.int64]) -> None:
        self._network = network
        self._snapshot = [weight.detach().clone() for weight in network.parameters()]
        device = network.from_step.weight.device
        self._steps = embed_step(torch.from_numpy(k.copy()).to(device))
        down, shrink, low = _block(network.down), _layer(network.shrink), _block(network.low)
        middle, grow, up = _block(network.middle), _layer(network.grow), _block(network.up)
        self._unet = _Unet(down, shrink, low, middle, grow, up, _layer(network.out))

    def is_current(self) -> bool:
        """Whether the network still has the weights of the snapshot."""
        return all(map(torch.equal, self._network.parameters(), self._snapshot))

    def condition(self, context: Single) -> tuple[Film, ...]:
        """FiLM terms of the four blocks for all reverse steps, for a context (1, 64)."""
        check_context(context.shape)
        with torch.inference_mode():
            shared = torch.from_numpy(context).to(self._steps.device)
            table = _array(self._network.condition(self._steps, shared))
        ends = np.cumsum(2 * np.array(self._network.film_channels))
        pairs = (np.split(part, 2, axis=1) for part in np.split(table, ends[:-1], axis=1))
        return tuple(Film(1.0 + scale, np.ascontiguousarray(shift)) for scale, shift in pairs)

    def predict(self, noisy: NDArray[np.float64], films: tuple[Film, ...], index: int) -> Single:
        """The network's output (B, H, 2) for x_k (B, H, 2) of reverse step `index`."""
        return _evaluate(self._unet, noisy.astype(np.float32), films, index)


@compiled
def _evaluate(unet: _Unet, noisy: Single, films: tuple[Film, ...], index: int) -> Single:
    """`ConditionalUnet1d.forward` on (B, H, 2)."""
    down, low, middle, up = films
    full = _residual(unet.down, noisy, down, index)
    half = _residual(unet.low, _convolve(full, unet.shrink, 2), low, index)
    half = _residual(unet.middle, half, middle, index)
    batch, length, channels = full.shape
    joined = np.empty((batch, length, 2 * channels), np.float32)
    # Two half-length channels become two neighbouring full-length positions.
    half = _convolve(half, unet.grow, 1).reshape(batch, length, channels)
    for b, i, c in np.ndindex(full.shape):
        joined[b, i, c], joined[b, i, channels + c] = half[b, i, c], full[b, i, c]
    return _convolve(_residual(unet.up, joined, up, index), unet.out, 1)


@compiled
def _residual(block: _Block, x: Single, film: Film, index: int) -> Single:
    """`ResidualBlock.forward` on (B, length, inputs), FiLM terms of reverse step `index`."""
    hidden = _convolve(x, block.first, 1)
    _activate(hidden, film.scale[index], film.shift[index])
    hidden = _convolve(hidden, block.second, 1)
    _activate(hidden, block.gain, np.zeros_like(block.gain))
    hidden += _convolve(x, block.skip, 1) if block.skip.weight.size else x
    return hidden


@compiled
def _convolve(x: Single, layer: _Layer, stride: int) -> Single:
    """(B, length, inputs) to (B, length / stride, outputs), padded with zeros."""
    batch, length, inputs = x.shape
    size, count = len(layer.weight) // inputs, length // stride
    windows = np.zeros((batch, count, size * inputs), np.float32)
    for place in range(count):
        for tap in range(size):
            source = place * stride + tap - size // 2
            if 0 <= source < length:
                for b in range(batch):
                    for c in range(inputs):
                        windows[b, place, tap * inputs + c] = x[b, source, c]
    product = np.dot(windows.reshape(batch * count, -1), layer.weight)
    product += layer.bias
    return product.reshape(batch, count, -1)


@compiled
def _activate(x: Single, scale: Single, shift: Single) -> None:
    """`normalise`, scale and shift (C,), then SiLU, in place on (B, length, C)."""
    batch, length, channels = x.shape
    one = np.float32(1.0)
    for sample in range(batch):
        for place in range(length):
            row = x[sample, place]
            total = np.float32(0.0)
            for c in range(channels):
                total += row[c] * row[c]
            mean = total / np.float32(channels) + np.float32(NORM_EPSILON)
            factor = one / np.float32(math.sqrt(mean))
            for c in range(channels):
                value = row[c] * factor * scale[c] + shift[c]
                row[c] = value / (one + np.exp(-value))


def _layer(layer: nn.Conv1d) -> _Layer:
    assert layer.bias is not None
    return _Layer(_array(layer.weight.permute(2, 1, 0).flatten(0, 1)), _array(layer.bias))


def _block(block: ResidualBlock) -> _Block:
    none = _Layer(np.zeros((0, 0), np.float32), np.zeros(0, np.float32))
    skip = none if block.skip is None else _layer(block.skip)
    return _Block(_layer(block.first), _layer(block.second), _array(block.gain), skip)


def _array(tensor: Tensor) -> Single:
    """A contiguous single-precision copy that shares nothing with torch."""
    return np.array(tensor.detach().cpu().numpy(), dtype=np.float32, order="C")
