"""The actor and critic that see pixels."""

from collections.abc import Sequence

import torch
from tensordict.nn import (
    InteractionType,
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictSequential,
)
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.modules import ActorValueOperator, ValueOperator


class Shrink(nn.Module):
    """Averages uint8 images over square cells: the part of the network that learns nothing, and so runs once a frame.

    Args:
        pool: side of a cell, pixels.
    """

    def __init__(self, pool: int):
        super().__init__()
        self.pool = nn.AvgPool2d(pool)

    def forward(self, pixels: Tensor) -> Tensor:
        """Shrink images: [..., H, W, 3] uint8 -> [..., 3, H // pool, W // pool] float32 in [−0.5, 0.5]."""
        images = pixels.reshape(-1, *pixels.shape[-3:]).permute(0, 3, 1, 2).contiguous().float()
        images = self.pool(images) / 255.0 - 0.5
        return images.reshape(*pixels.shape[:-3], *images.shape[1:])


class Trunk(nn.Module):
    """A small convolutional network over images, batched or not.

    Args:
        height: of the image, pixels.
        width: of the image, pixels.
        channels: of the two convolutions.
        features: size of the output.

    Raises:
        ValueError: for an image of which the convolutions leave nothing.
    """

    def __init__(self, height: int, width: int, channels: Sequence[int] = (16, 32), features: int = 128):
        super().__init__()
        if min(height, width) < 8:
            raise ValueError(f"image: expected sides of at least 8 · pool pixels, got {height} × {width} after pooling")
        first, second = channels
        self.convolutions = nn.Sequential(
            nn.Conv2d(3, first, 4, stride=2),
            nn.ReLU(),
            nn.Conv2d(first, second, 3, stride=2),
            nn.ReLU(),
            nn.Flatten(),
        )
        flat = self.convolutions(torch.zeros(1, 3, height, width)).shape[1]
        self.head = nn.Sequential(nn.Linear(flat, features), nn.ReLU())

    def forward(self, image: Tensor) -> Tensor:
        """Encode images: [..., 3, H, W] float32 -> [..., features] float32."""
        features = self.head(self.convolutions(image.reshape(-1, *image.shape[-3:])))
        return features.reshape(*image.shape[:-3], -1)


def actor_critic(
    image_shape: Sequence[int],
    actions: int,
    pool: int = 2,
    channels: Sequence[int] = (16, 32),
    features: int = 128,
) -> ActorValueOperator:
    """Actor and critic over one trunk: ``pixels`` -> ``image`` -> ``hidden`` -> ``action`` and ``state_value``.

    Args:
        image_shape: (H, W, 3).
        actions: number of discrete actions.
        pool: see ``Shrink``.
        channels: see ``Trunk``.
        features: see ``Trunk``.

    Returns:
        Operator whose ``get_policy_operator()`` acts, and whose heads share the ``hidden`` that the trunk computed.
    """
    trunk = Trunk(image_shape[0] // pool, image_shape[1] // pool, channels, features)
    policy, value = nn.Linear(features, actions), nn.Linear(features, 1)
    layers = [module for module in trunk.modules() if isinstance(module, (nn.Conv2d, nn.Linear))]
    for layer, gain in [*((layer, 2**0.5) for layer in layers), (policy, 0.01), (value, 1.0)]:
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.constant_(layer.get_parameter("bias"), 0.0)
    head = ProbabilisticTensorDictSequential(
        TensorDictModule(policy, in_keys=["hidden"], out_keys=["logits"]),
        ProbabilisticTensorDictModule(
            in_keys=["logits"],
            out_keys=["action"],
            distribution_class=Categorical,
            default_interaction_type=InteractionType.RANDOM,  # TorchRL's default is the mode, also in env.rollout
            return_log_prob=True,
            log_prob_key="action_log_prob",
        ),
    )
    return ActorValueOperator(
        TensorDictSequential(
            TensorDictModule(Shrink(pool), in_keys=["pixels"], out_keys=["image"]),
            TensorDictModule(trunk, in_keys=["image"], out_keys=["hidden"]),
        ),
        head,
        ValueOperator(value, in_keys=["hidden"]),
    )
