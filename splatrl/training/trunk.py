"""The parts of a network that read images."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from splatrl.native import _core
from splatrl.native.tracing import traced
from splatrl.training.convolution import Convolution
from splatrl.training.heads import orthogonal
from splatrl.training.native_trunk import encoded, suits

GAIN = 2**0.5
"""Orthogonal-initialisation gain for layers followed by a ReLU."""


class PoolPixels(nn.Module):
    """Averages images over square cells: the weight-free part of the network, which runs once per frame.

    Args:
        pool: side of a cell, pixels.
    """

    def __init__(self, pool: int):
        super().__init__()
        self.side = pool

    def forward(self, pixels: Tensor) -> Tensor:
        """Pool images, uint8 or float32 in [0, 1]: [..., H, W, C] -> [..., H // pool, W // pool, C] in [−0.5, 0.5]."""
        images = pixels.reshape(-1, *pixels.shape[-3:])
        if _by_core(images):
            pooled = self._averages(images.contiguous())
        else:
            pooled = self._means(images) / (255.0 if images.dtype == torch.uint8 else 1.0) - 0.5
        return pooled.reshape(*pixels.shape[:-3], *pooled.shape[1:])

    def _means(self, images: Tensor) -> Tensor:
        """Average images with PyTorch, which reads them as they are and writes no floats of their size."""
        height, width = (size // self.side for size in images.shape[1:3])
        whole = images[:, : height * self.side, : width * self.side]
        cells = whole.reshape(-1, height, self.side, width, self.side, images.shape[3])
        return cells.sum((2, 4), dtype=torch.float32) / self.side**2

    def _averages(self, images: Tensor) -> Tensor:
        """Pool images in the C++ core, without the intermediate tensors that PyTorch would write."""
        count, height, width, depth = images.shape
        pooled = torch.empty(count, height // self.side, width // self.side, depth)
        floats = images.dtype == torch.float32
        _core.pool_images(images.data_ptr(), (count, height, width, depth), self.side, floats, pooled.data_ptr())
        return pooled


def _by_core(images: Tensor) -> bool:
    """Whether the core can pool images: it needs values in main memory, which ``vmap`` and tracers do not have."""
    plain = images.dtype in (torch.uint8, torch.float32) and not images.requires_grad
    return plain and images.device.type == "cpu" and not traced(images)


def two_convolutions(height: int, width: int, depth: int, channels: Sequence[int]) -> nn.Sequential:
    """Make two convolutions with a ReLU between them.

    Args:
        height: height of the image, pixels.
        width: width of the image, pixels.
        depth: channels of the image.
        channels: output channels of each convolution.

    Raises:
        ValueError: if the image is too small for them, or ``channels`` does not hold two numbers.
    """
    if min(height, width) < 8:
        raise ValueError(f"image: expected at least 8 × 8 pixels after pooling, got {height} × {width}")
    if len(channels) != 2:
        raise ValueError(f"network.channels: expected two numbers, got {list(channels)}")
    first, second = channels
    return nn.Sequential(
        orthogonal(Convolution(depth, first, 4, stride=2), GAIN),
        nn.ReLU(inplace=True),
        orthogonal(Convolution(first, second, 3, stride=2), GAIN),
    )


class Trunk(nn.Module):
    """A small convolutional network over images, batched or not.

    On a CPU with AVX2 its layers are compiled (``native_trunk``), if the channels are multiples of sixteen; elsewhere
    they are PyTorch's.

    Args:
        height: height of the image, pixels.
        width: width of the image, pixels.
        depth: channels of the image, 3 for each stacked frame.
        channels: output channels of the two convolutions.
        features: size of the output.

    Raises:
        ValueError: if the image is too small for the convolutions, or ``channels`` does not hold two numbers.
    """

    def __init__(
        self, height: int, width: int, depth: int = 3, channels: Sequence[int] = (16, 32), features: int = 128
    ):
        super().__init__()
        self.convolutions = two_convolutions(height, width, depth, channels).append(nn.ReLU(inplace=True))
        flat = self.convolutions(torch.zeros(1, depth, height, width)).numel()
        self.dense = nn.Sequential(orthogonal(nn.Linear(flat, features), GAIN), nn.ReLU(inplace=True))

    def forward(self, image: Tensor) -> Tensor:
        """Encode images: [..., H, W, C] float32 -> [..., features] float32."""
        images = image.reshape(-1, *image.shape[-3:])
        if suits(images, self.convolutions, self.dense):
            return encoded(images, self.convolutions, self.dense).reshape(*image.shape[:-3], -1)
        found = self.convolutions(images.permute(0, 3, 1, 2))  # channels last in memory is faster
        return self.dense(found.permute(0, 2, 3, 1).flatten(1)).reshape(*image.shape[:-3], -1)
