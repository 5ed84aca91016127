"""The convolution whose weight gradient is a product of matrices."""

import copy

import pytest
import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d

from splatrl.training.convolution import Convolution, Convolved

SHAPES = [
    ((5, 3, 15, 12), (7, 4, 4), 2),
    ((4, 16, 9, 10), (6, 3, 3), 2),
    ((2, 4, 7, 6), (3, 3, 2), 1),
    ((3, 1, 5, 5), (2, 2, 3), 3),
    ((0, 3, 8, 8), (4, 4, 4), 2),
]
"""Shapes of images [N, C, H, W], of filters (F, height, width), and strides."""


def example(shape: tuple[int, ...], filters: tuple[int, int, int], last: bool) -> tuple[Tensor, nn.Conv2d]:
    torch.manual_seed(0)
    images = torch.randn(shape, dtype=torch.float64)
    if last:
        images = images.contiguous(memory_format=torch.channels_last)
    count, height, width = filters
    return images.requires_grad_(), nn.Conv2d(shape[1], count, (height, width)).double()


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize(("shape", "filters", "stride"), SHAPES)
def test_values_and_gradients_are_pytorchs(
    shape: tuple[int, ...], filters: tuple[int, int, int], stride: int, last: bool
) -> None:
    images, layer = example(shape, filters, last)
    assert layer.bias is not None
    given = images, layer.weight, layer.bias
    expected = conv2d(*given, stride)
    found = Convolved.apply(*given, (stride, stride))
    torch.testing.assert_close(found, expected)
    slope = torch.randn_like(expected)
    for mine, theirs in zip(
        torch.autograd.grad(found, given, slope), torch.autograd.grad(expected, given, slope), strict=True
    ):
        torch.testing.assert_close(mine, theirs)


def test_products_are_rounded_as_before_afterwards() -> None:
    before = torch.backends.cuda.matmul.fp32_precision
    images, layer = example((2, 3, 8, 8), (4, 4, 4), True)
    Convolved.apply(images, layer.weight, layer.bias, (2, 2)).sum().backward()
    assert torch.backends.cuda.matmul.fp32_precision == before


@pytest.mark.gpu
@pytest.mark.parametrize(("shape", "filters", "stride"), SHAPES[:4])
def test_gradients_on_a_gpu_are_a_cpus(
    cuda_device: torch.device, shape: tuple[int, ...], filters: tuple[int, int, int], stride: int
) -> None:
    torch.manual_seed(0)
    count, *window = filters
    layer = Convolution(shape[1], count, (window[0], window[1]), stride)
    images = torch.randn(shape)
    found = []
    for device in ("cpu", cuda_device):
        there, seen = copy.deepcopy(layer).to(device), images.to(device).requires_grad_()
        slopes = torch.autograd.grad(there(seen).square().sum(), (seen, *there.parameters()))
        found.append([slope.cpu() for slope in slopes])
    for mine, theirs in zip(*found, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-2, atol=1e-2 * float(theirs.abs().max()))


@pytest.mark.gpu
def test_a_gpu_convolves_under_vmap_and_without_gradients(cuda_device: torch.device) -> None:
    layer = Convolution(3, 4, 4, 2).to(cuda_device)
    images = torch.rand(2, 5, 3, 8, 8, device=cuda_device)
    with torch.no_grad():
        each = torch.stack([layer(one) for one in images])
    weights = {name: torch.stack([value, value]) for name, value in layer.named_parameters()}
    together = torch.vmap(lambda own, seen: torch.func.functional_call(layer, own, seen))(weights, images)
    torch.testing.assert_close(together, each, rtol=1e-2, atol=1e-2)
