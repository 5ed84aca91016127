"""The actor and critic that see pixels."""

from collections.abc import Sequence

import torch
from tensordict.nn import (
    InteractionType,
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.modules import ActorValueOperator, ValueOperator


class PixelTrunk(nn.Module):
    """A small convolutional network over uint8 images, batched or not.

    Args:
        height: of the image, pixels.
        width: of the image, pixels.
        pool: side of the average-pooling cells in front, pixels.
        channels: of the two convolutions.
        features: size of the output.

    Raises:
        ValueError: for an image of which the convolutions leave nothing.
    """

    def __init__(self, height: int, width: int, pool: int = 2, channels: Sequence[int] = (16, 32), features: int = 128):
        super().__init__()
        if min(height, width) < 8 * pool:
            raise ValueError(f"image: expected sides of at least 8 · pool = {8 * pool} pixels, got {height} × {width}")
        first, second = channels
        self.pool = nn.AvgPool2d(pool)
        self.convolutions = nn.Sequential(
            nn.Conv2d(3, first, 4, stride=2),
            nn.ReLU(),
            nn.Conv2d(first, second, 3, stride=2),
            nn.ReLU(),
            nn.Flatten(),
        )
        flat = self.convolutions(self.pool(torch.zeros(1, 3, height, width))).shape[1]
        self.head = nn.Sequential(nn.Linear(flat, features), nn.ReLU())

    def forward(self, pixels: Tensor) -> Tensor:
        """Encode images: [..., H, W, 3] uint8 -> [..., features] float32."""
        images = pixels.reshape(-1, *pixels.shape[-3:]).permute(0, 3, 1, 2).contiguous().float()
        features = self.convolutions(self.pool(images) / 255.0 - 0.5)  # scaled once there are fewer of them
        return self.head(features).reshape(*pixels.shape[:-3], -1)


def actor_critic(
    image_shape: Sequence[int],
    actions: int,
    pool: int = 2,
    channels: Sequence[int] = (16, 32),
    features: int = 128,
) -> ActorValueOperator:
    """Actor and critic over one trunk: ``pixels`` -> ``hidden`` -> ``logits``, ``action`` and ``state_value``.

    Args:
        image_shape: (H, W, 3).
        actions: number of discrete actions.
        pool: see ``PixelTrunk``.
        channels: see ``PixelTrunk``.
        features: see ``PixelTrunk``.

    Returns:
        Operator whose ``get_policy_operator()`` acts, and whose heads share the ``hidden`` that the trunk computed.
    """
    trunk = PixelTrunk(image_shape[0], image_shape[1], pool, channels, features)
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
        TensorDictModule(trunk, in_keys=["pixels"], out_keys=["hidden"]),
        head,
        ValueOperator(value, in_keys=["hidden"]),
    )
