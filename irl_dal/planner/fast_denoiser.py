"""The trained U-Net compiled, for planning one chunk at a time on a CPU.

Of a U-Net of this size a deep-learning library spends most of the time on the overhead of its
operators. Here activations are channels-last, every convolution is one matrix product, norm, FiLM
and activation are one loop, and what depends only on k and the context is computed once per plan
for all k. The arithmetic is that of `ConditionalUnet1d`, to single-precision rounding.
"""

from __future__ import annotations

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

GROUP = 4
"""Samples whose convolutions share one reading of the weights."""


class _Layer(NamedTuple):
    """A length-3 or length-1 convolution as a matrix (3 * inputs, outputs) or (inputs, outputs)."""

    weight: Single
    bias: Single


class _Block(NamedTuple):
    """A `ResidualBlock`; one without a skip convolution has an empty one."""

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
    """1 + scale and shift of one block for all reverse steps, each (S, B or 1, C)."""

    scale: Single
    shift: Single


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
        self._unet = _Unet(
            down=_block(network.down),
            shrink=_layer(network.shrink),
            low=_block(network.low),
            middle=_block(network.middle),
            grow=_layer(network.grow),
            up=_block(network.up),
            out=_layer(network.out),
        )

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
                hidden /= 1.0 + np.exp(-hidden)  # SiLU; where exp(-x) overflows, x / inf
                hidden = hidden.reshape(-1, hidden.shape[-1]) @ weight
                hidden += bias
        table = hidden.reshape(len(self._steps), len(context), -1)
        films, start = [], 0
        for channels in self._channels:
            scale = table[..., start : start + channels] + np.float32(1.0)
            shift = np.ascontiguousarray(table[..., start + channels : start + 2 * channels])
            films.append(Film(scale, shift))
            start += 2 * channels
        return tuple(films)

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
    joined[:, :, :channels] = _convolve(half, unet.grow, 1).reshape(batch, length, channels)
    joined[:, :, channels:] = full
    return _convolve(_residual(unet.up, joined, up, index), unet.out, 1)


@compiled
def _residual(block: _Block, x: Single, film: Film, index: int) -> Single:
    """`ResidualBlock.forward` on (B, length, inputs), FiLM terms of reverse step `index`."""
    hidden = _convolve(x, block.first, 1)
    _activate(hidden, film.scale[index], film.shift[index])
    hidden = _convolve(hidden, block.second, 1)
    gain = block.gain.reshape(1, -1)
    _activate(hidden, gain, np.zeros_like(gain))
    if block.skip.weight.size:
        hidden += _convolve(x, block.skip, 1)
    else:
        hidden += x
    return hidden


@compiled
def _convolve(x: Single, layer: _Layer, stride: int) -> Single:
    """(B, length, inputs) to (B, length / stride, outputs), padded with zeros.

    A matrix product of so few rows is bound by reading the weights: four rows of them at a time
    serve all positions of `GROUP` samples, whose sums stay in the nearest cache.
    """
    batch, length, inputs = x.shape
    outputs = len(layer.bias)
    taps = len(layer.weight) // inputs
    result = np.empty((batch, length // stride, outputs), np.float32)
    result[:] = layer.bias
    for first in range(0, batch, GROUP):
        samples = range(first, min(first + GROUP, batch))
        for tap in range(taps):
            weight = layer.weight[tap * inputs : (tap + 1) * inputs]
            for j in range(0, inputs - 3, 4):
                w0, w1, w2, w3 = weight[j], weight[j + 1], weight[j + 2], weight[j + 3]
                for sample in samples:
                    for place in range(length // stride):
                        source = place * stride + tap - taps // 2
                        if 0 <= source < length:
                            seen, row = x[sample, source], result[sample, place]
                            x0, x1, x2, x3 = seen[j], seen[j + 1], seen[j + 2], seen[j + 3]
                            for c in range(outputs):
                                row[c] += x0 * w0[c] + x1 * w1[c] + x2 * w2[c] + x3 * w3[c]
            for j in range(inputs // 4 * 4, inputs):  # what is left over
                for sample in samples:
                    for place in range(length // stride):
                        source = place * stride + tap - taps // 2
                        if 0 <= source < length:
                            for c in range(outputs):
                                result[sample, place, c] += x[sample, source, j] * weight[j, c]
    return result


@compiled
def _activate(x: Single, scale: Single, shift: Single) -> None:
    """`normalise`, scale and shift (B or 1, C), then SiLU, in place on (B, length, C)."""
    batch, length, channels = x.shape
    one = np.float32(1.0)
    for sample in range(batch):
        shared = sample if len(scale) > 1 else 0
        for place in range(length):
            row = x[sample, place]
            total = np.float32(0.0)
            for c in range(channels):
                total += row[c] * row[c]
            mean = total / np.float32(channels) + np.float32(NORM_EPSILON)
            factor = one / np.float32(math.sqrt(mean))
            for c in range(channels):
                value = row[c] * factor * scale[shared, c] + shift[shared, c]
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
