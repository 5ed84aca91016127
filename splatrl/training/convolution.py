"""A convolution whose gradients are fast on a GPU for images of few channels."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import conv2d
from torch.nn.grad import conv2d_input

from splatrl.native.tracing import traced


class Convolution(nn.Conv2d):
    """``nn.Conv2d`` without padding, dilation or groups, whose weight gradient on a GPU is a product of two matrices.

    For sixteen channels, thirty-two filters and thousands of images, cuDNN's kernel for this gradient takes four times
    as long as the product (docs/gpu.md).
    """

    def forward(self, images: Tensor) -> Tensor:
        """Convolve images: [N, C, H, W] -> [N, F, height, width]."""
        if _differentiated_on_a_gpu(images) and self.bias is not None:
            return Convolved.apply(images, self.weight, self.bias, self.stride)
        return super().forward(images)


class Convolved(torch.autograd.Function):
    """``conv2d`` with a stride, for any device; images are read with their channels last."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, weight: Tensor, bias: Tensor, stride: tuple[int, int]) -> Tensor:
        """Convolve images: [N, C, H, W], [F, C, h, w] and [F] -> [N, F, height, width]."""
        ctx.save_for_backward(images, weight)
        ctx.stride = stride
        return conv2d(images, weight, bias, stride)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of images, where they are asked for, of weight and of bias."""
        images, weight = ctx.saved_tensors
        of_images = None
        if ctx.needs_input_grad[0]:
            of_images = conv2d_input(images.shape, weight, slope, ctx.stride)
        filters, depth, *window = weight.shape
        slopes = slope.permute(0, 2, 3, 1).reshape(-1, filters)
        with _rounding_as_convolutions():
            of_weight = slopes.T @ _windows(images, window, ctx.stride, slope.shape[2:])
        return of_images, of_weight.view(filters, *window, depth).permute(0, 3, 1, 2), slopes.sum(0), None


def _windows(images: Tensor, window: list[int], stride: tuple[int, int], places: torch.Size) -> Tensor:
    """Return what each filter sees at each place, [N · height · width, h · w · C]."""
    last = images.permute(0, 2, 3, 1).contiguous()
    (count, height, width, depth), (down, right) = last.shape, stride
    line = width * depth
    shape = count, *places, window[0], window[1] * depth
    steps = height * line, down * line, right * depth, line, 1
    return last.as_strided(shape, steps).reshape(-1, window[0] * window[1] * depth)


def _differentiated_on_a_gpu(images: Tensor) -> bool:
    """Whether gradients are wanted of a plain convolution on a GPU: ``vmap``, compilers and autocast have their own."""
    if not images.is_cuda or not torch.is_grad_enabled() or images.dtype != torch.float32:
        return False
    return not traced(images) and not torch.is_autocast_enabled(images.device.type)


@contextmanager
def _rounding_as_convolutions() -> Iterator[None]:
    """Round the factors of matrix products as cuDNN rounds those of convolutions: by default, to TF32."""
    products, convolutions = torch.backends.cuda.matmul, torch.backends.cudnn.conv  # type: ignore[attr-defined]
    before = products.fp32_precision
    products.fp32_precision = convolutions.fp32_precision
    try:
        yield
    finally:
        products.fp32_precision = before
