"""The compiled layers against PyTorch's own."""

import pytest
import torch
from torch import Tensor

from splatrl.native import _core
from splatrl.training import native_trunk
from splatrl.training.native_trunk import encoded, suits
from splatrl.training.trunk import Trunk

SHAPES = [(32, 32, 3, (16, 32), 128, 37), (29, 37, 5, (32, 16), 50, 19), (8, 9, 1, (48, 64), 7, 1)]
"""Height, width and channels of images; channels of the convolutions; features; how many images."""


def trunk_and_images(
    height: int, width: int, depth: int, channels: tuple[int, int], features: int, count: int
) -> tuple[Trunk, Tensor, Tensor]:
    """Make a trunk whose biases are not zero, images, and a gradient of their features."""
    torch.manual_seed(0)
    trunk = Trunk(height, width, depth, channels, features)
    for parameter in trunk.parameters():
        parameter.data += 0.02 * torch.randn_like(parameter)
    return trunk, torch.rand(count, height, width, depth) - 0.5, torch.randn(count, features)


def in_torch(trunk: Trunk, images: Tensor) -> Tensor:
    """Return the features that PyTorch's layers give in double precision."""
    found = trunk.double().convolutions(images.double().permute(0, 3, 1, 2))
    return trunk.dense(found.permute(0, 2, 3, 1).flatten(1))


@pytest.mark.parametrize("shape", SHAPES)
def test_features_and_gradients_match_those_of_pytorchs_layers(shape: tuple) -> None:
    trunk, images, slope = trunk_and_images(*shape)
    features = encoded(images, trunk.convolutions, trunk.dense)
    gradients = torch.autograd.grad(features, list(trunk.parameters()), slope)
    expected = in_torch(trunk, images)
    torch.testing.assert_close(features.double(), expected, atol=1e-5, rtol=1e-5)
    right_gradients = torch.autograd.grad(expected, list(trunk.parameters()), slope.double())
    for found, right in zip(gradients, right_gradients, strict=True):
        assert (found - right).abs().max() <= 1e-5 * right.abs().max()


def test_cores_and_the_rest_of_the_batch_change_no_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    trunk, images, slope = trunk_and_images(*SHAPES[0])
    results = []
    for cores in (1, 2, 5):
        monkeypatch.setattr(native_trunk, "_threads", lambda count, cores=cores: cores)
        features = encoded(images, trunk.convolutions, trunk.dense)
        results.append([features.detach(), *torch.autograd.grad(features, list(trunk.parameters()), slope)])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))
    alone = encoded(images[20:21], trunk.convolutions, trunk.dense)
    assert torch.equal(alone, results[0][0][20:21])


@pytest.mark.parametrize("isa", _core.supported_isas())
def test_every_instruction_set_agrees(isa: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATRL_ISA", isa)
    assert _core.isa() == isa
    trunk, images, slope = trunk_and_images(*SHAPES[1])
    features = encoded(images, trunk.convolutions, trunk.dense)
    found = [features, *torch.autograd.grad(features, list(trunk.parameters()), slope)]
    right = in_torch(trunk, images)
    wanted = [right, *torch.autograd.grad(right, list(trunk.parameters()), slope.double())]
    for mine, theirs in zip(found, wanted, strict=True):
        assert float((mine - theirs).abs().max() / theirs.abs().max()) < 1e-5


def test_an_empty_batch_has_a_gradient_of_zero() -> None:
    trunk, images, slope = trunk_and_images(*SHAPES[0])
    features = encoded(images[:0], trunk.convolutions, trunk.dense)
    assert features.shape == (0, 128)
    assert not any(g.any() for g in torch.autograd.grad(features, list(trunk.parameters()), slope[:0]))


def test_pytorchs_layers_are_used_where_the_compiled_ones_cannot_be() -> None:
    trunk, images, _ = trunk_and_images(*SHAPES[0])
    layers = trunk.convolutions, trunk.dense
    assert not suits(images.double(), *layers)
    assert not suits(images.clone().requires_grad_(), *layers)
    odd = Trunk(32, 32, 3, (8, 32), 128)
    assert not suits(images, odd.convolutions, odd.dense)
    assert odd(images).shape == (37, 128)


def test_a_trunk_of_an_invalid_shape_is_refused() -> None:
    for shape in [(7, 32, 3, 16, 32, 8), (32, 32, 3, 8, 32, 8), (32, 32, 0, 16, 32, 8), (32, 32, 3, 16, 32, 0)]:
        with pytest.raises(ValueError, match="shape: expected"):
            _core.trunk_forward(shape, 0, 0, (0,) * 6, (0,) * 3, 1)
