"""The actor and critic, which see pixels."""

from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.modules import ActorValueOperator, ValueOperator

from splatrl.training.heads import orthogonal, policy_head
from splatrl.training.memory import gru
from splatrl.values import require_number

GAIN = 2**0.5
"""Orthogonal-initialisation gain for layers followed by a ReLU."""


class PoolPixels(nn.Module):
    """Averages uint8 images over square cells: the part of the network without weights, which runs once per frame.

    Args:
        pool: side of a cell, pixels.
    """

    def __init__(self, pool: int):
        super().__init__()
        self.pool = nn.AvgPool2d(pool)

    def forward(self, pixels: Tensor) -> Tensor:
        """Pool images: [..., H, W, C] uint8 -> [..., H // pool, W // pool, C] float32 in [−0.5, 0.5]."""
        images = pixels.reshape(-1, *pixels.shape[-3:]).permute(0, 3, 1, 2).float()
        images = (self.pool(images) / 255.0 - 0.5).permute(0, 2, 3, 1)
        return images.reshape(*pixels.shape[:-3], *images.shape[1:])


class Trunk(nn.Module):
    """A small convolutional network over images, batched or not.

    Args:
        height: height of the image, pixels.
        width: width of the image, pixels.
        depth: channels of the image, 3 for each stacked frame.
        channels: output channels of the two convolutions.
        features: size of the output.

    Raises:
        ValueError: for an image that is too small for the convolutions, or other than two of them.
    """

    def __init__(
        self, height: int, width: int, depth: int = 3, channels: Sequence[int] = (16, 32), features: int = 128
    ):
        super().__init__()
        if min(height, width) < 8:
            raise ValueError(f"image: expected sides of at least 8 · pool pixels, got {height} × {width} after pooling")
        if len(channels) != 2:
            raise ValueError(f"network.channels: expected two numbers, got {list(channels)}")
        first, second = channels
        self.convolutions = nn.Sequential(
            orthogonal(nn.Conv2d(depth, first, 4, stride=2), GAIN),
            nn.ReLU(inplace=True),
            orthogonal(nn.Conv2d(first, second, 3, stride=2), GAIN),
            nn.ReLU(inplace=True),
        )
        flat = self.convolutions(torch.zeros(1, depth, height, width)).numel()
        self.dense = nn.Sequential(orthogonal(nn.Linear(flat, features), GAIN), nn.ReLU(inplace=True))

    def forward(self, image: Tensor) -> Tensor:
        """Encode images: [..., H, W, C] float32 -> [..., features] float32."""
        images = image.reshape(-1, *image.shape[-3:]).permute(0, 3, 1, 2)  # channels last in memory is faster
        found = self.convolutions(images).permute(0, 2, 3, 1).flatten(1)
        return self.dense(found).reshape(*image.shape[:-3], -1)


def actor_critic(
    image_shape: Sequence[int],
    action_spec: TensorSpec,
    pool: int = 2,
    channels: Sequence[int] = (16, 32),
    features: int = 128,
    memory: int = 0,
) -> ActorValueOperator:
    """Actor and critic over one trunk: ``pixels`` -> ``image`` -> ``hidden`` -> ``action`` and ``state_value``.

    Args:
        image_shape: (H, W, C), where C is 3 for each stacked frame.
        action_spec: action spec of the env, batched or not; see ``policy_head``.
        pool: see ``PoolPixels``.
        channels: see ``Trunk``.
        features: see ``Trunk``.
        memory: size of a GRU's state between trunk and heads, for which the env needs ``memory_transforms(memory)``; 0
            is no GRU.

    Returns:
        Operator whose ``get_policy_operator()`` acts, and whose heads share the trunk's ``hidden``.

    Raises:
        ValueError: for sizes that are no whole numbers in their ranges.
    """
    require_number("network.pool", pool, 1, whole=True)
    require_number("network.features", features, 1, whole=True)
    require_number("network.memory", memory, 0, whole=True)
    for count in channels:
        require_number("network.channels", count, 1, whole=True)
    height, width, depth = image_shape
    trunk = Trunk(height // pool, width // pool, depth, channels, features)
    seen = "features" if memory else "hidden"
    layers: list[TensorDictModuleBase] = [
        TensorDictModule(PoolPixels(pool), in_keys=["pixels"], out_keys=["image"]),
        TensorDictModule(trunk, in_keys=["image"], out_keys=[seen]),
    ]
    if memory:
        layers.append(gru(features, memory))
    known = memory or features
    value = ValueOperator(orthogonal(nn.Linear(known, 1), 1.0), in_keys=["hidden"])
    return ActorValueOperator(TensorDictSequential(*layers), policy_head(action_spec, known), value)
