"""The layers of ``Trunk``, which read images, forwards and backwards in compiled C++."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from splatrl.native import _core
from splatrl.native.threads import usable_cores
from splatrl.native.tracing import traced

FAST = ("avx2", "avx512")
"""Instruction sets with which the compiled layers are faster than PyTorch's."""
LANES = 16
"""Channels of the convolutions must be multiples of this number."""
LARGE = 64
"""Number of images from which on threads save more time than starting them costs."""


def suits(images: Tensor, convolutions: nn.Sequential, dense: nn.Sequential) -> bool:
    """Whether the compiled layers support these images and weights, and are faster than PyTorch's.

    Args:
        images: [N, H, W, C].
        convolutions: two convolutions, each followed by a ReLU.
        dense: a linear layer followed by a ReLU.
    """
    if traced(images) or images.requires_grad:
        return False
    weights = (*convolutions.parameters(), *dense.parameters())
    plain = all(each.dtype == torch.float32 and each.device.type == "cpu" for each in (images, *weights))
    fits = all(len(bias) % LANES == 0 for bias in weights[1:4:2])  # the biases of the convolutions
    return plain and fits and _core.isa() in FAST


def encoded(images: Tensor, convolutions: nn.Sequential, dense: nn.Sequential) -> Tensor:
    """Encode images as features, differentiable with respect to the weights: [N, H, W, C] -> [N, F], float32.

    All cores share the work. Neither their number nor the size of a batch changes a byte of an image's features, and
    gradients are always summed over sixteen images at a time, however many cores there are.

    Args:
        images: images that pass ``suits``.
        convolutions: two convolutions, each followed by a ReLU.
        dense: a linear layer followed by a ReLU.
    """
    weights = (each.contiguous() for each in (*convolutions.parameters(), *dense.parameters()))
    return _Encoding.apply(images.contiguous(), *weights)


def forward(images: Tensor, weights: Sequence[Tensor]) -> list[Tensor]:
    """Return the output of each layer.

    Args:
        images: [N, H, W, C] float32 on the CPU, contiguous.
        weights: weight and bias of each of the three layers, in PyTorch's shapes, float32 on the CPU, contiguous.

    Returns:
        The outputs of the two convolutions, [N, height, width, channels], and the features [N, F]: float32, after the
        ReLU.
    """
    count, height, width, _ = images.shape
    first, second, features = (len(bias) for bias in weights[1::2])
    tall, wide = ((side - 4) // 2 + 1 for side in (height, width))
    shapes = (tall, wide, first), ((tall - 3) // 2 + 1, (wide - 3) // 2 + 1, second), (features,)
    layers = [images.new_empty(count, *shape) for shape in shapes]
    given = images.data_ptr(), count, addresses(weights), addresses(layers)
    _core.trunk_forward(_shape(images, weights), *given, _threads(count))
    return layers


def backward(images: Tensor, weights: Sequence[Tensor], layers: Sequence[Tensor], slope: Tensor) -> list[Tensor]:
    """Return the gradients of the weights.

    Args:
        images: see ``forward``.
        weights: see ``forward``.
        layers: what ``forward`` returned for them.
        slope: [N, F] float32, contiguous: the gradient of the features.

    Returns:
        One gradient for each of ``weights``, of the same shape.
    """
    gradients, count = [torch.empty_like(weight) for weight in weights], len(images)
    given = images.data_ptr(), count, addresses(weights), addresses(layers), slope.data_ptr()
    _core.trunk_backward(_shape(images, weights), *given, addresses(gradients), _threads(count))
    return gradients


def addresses(tensors: Sequence[Tensor]) -> tuple[int, ...]:
    """Return the addresses of tensors of any shape in memory."""
    return tuple(tensor.data_ptr() for tensor in tensors)


class _Encoding(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, images: Tensor, *weights: Tensor) -> Tensor:
        layers = forward(images, weights)
        ctx.save_for_backward(images, *weights, *layers)
        return layers[-1]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        images, *known = ctx.saved_tensors
        return (None, *backward(images, known[:6], known[6:], slope.contiguous()))


def _shape(images: Tensor, weights: Sequence[Tensor]) -> tuple[int, ...]:
    return (*images.shape[1:], *(len(bias) for bias in weights[1::2]))


def _threads(count: int) -> int:
    return usable_cores() if count >= LARGE else 1
