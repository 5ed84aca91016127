"""A custom network: from ``pixels`` via ``image`` to ``hidden``, and from there to action and value."""

from collections.abc import Sequence

from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import TensorSpec
from torchrl.modules import ActorValueOperator, ValueOperator

from splatrl.training.heads import policy_head
from splatrl.training.networks import PoolPixels


def linear(image_shape: Sequence[int], action_spec: TensorSpec, pool: int = 4, features: int = 32, memory: int = 0):
    """One linear layer over coarse pixels, with heads for action and value."""
    height, width, channels = image_shape
    inputs = (height // pool) * (width // pool) * channels
    layer = nn.Sequential(nn.Flatten(-3), nn.Linear(inputs, features), nn.ReLU())
    trunk = TensorDictSequential(
        TensorDictModule(PoolPixels(pool), in_keys=["pixels"], out_keys=["image"]),
        TensorDictModule(layer, in_keys=["image"], out_keys=["hidden"]),
    )
    value = ValueOperator(nn.Linear(features, 1), in_keys=["hidden"])
    return ActorValueOperator(trunk, policy_head(action_spec, features), value)
