"""The actor and critic, which see pixels or what else they are given to read."""

from collections.abc import Mapping, Sequence

from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.data import TensorSpec
from torchrl.modules import ActorValueOperator, ValueOperator

from splatrl.training.heads import orthogonal, policy_head
from splatrl.training.inputs import Input, JoinedTrunk, Prepare
from splatrl.training.memory import gru
from splatrl.training.trunk import PoolPixels, Trunk
from splatrl.values import require_number


def actor_critic(
    image_shape: Sequence[int],
    action_spec: TensorSpec,
    pool: int = 2,
    channels: Sequence[int] = (16, 32),
    features: int = 128,
    memory: int = 0,
    inputs: Mapping[str, Input] | None = None,
) -> ActorValueOperator:
    """Actor and critic over one trunk: ``pixels`` -> ``image`` -> ``hidden`` -> ``action`` and ``state_value``.

    With ``inputs`` it reads those in place of ``pixels``, and from what they are encoded as, ``image`` and ``vector``.

    Args:
        image_shape: (H, W, C), where C is 3 for each stacked frame.
        action_spec: action spec of the env, batched or not; see ``policy_head``.
        pool: see ``PoolPixels``.
        channels: see ``Trunk``.
        features: see ``Trunk``.
        memory: size of a GRU's state between trunk and heads, for which the env needs ``memory_transforms(memory)``; 0
            is no GRU.
        inputs: what is read in place of pixels, by key; see ``inputs_of``.

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
    reads, prepared, prepare, trunk = _reader(image_shape, pool, channels, features, inputs)
    seen = "features" if memory else "hidden"
    layers: list[TensorDictModuleBase] = [
        TensorDictModule(prepare, in_keys=reads, out_keys=prepared),
        TensorDictModule(trunk, in_keys=prepared, out_keys=[seen]),
    ]
    if memory:
        layers.append(gru(features, memory))
    known = memory or features
    value = ValueOperator(orthogonal(nn.Linear(known, 1), 1.0), in_keys=["hidden"])
    return ActorValueOperator(TensorDictSequential(*layers), policy_head(action_spec, known), value)


def _reader(
    image_shape: Sequence[int], pool: int, channels: Sequence[int], features: int, inputs: Mapping[str, Input] | None
) -> tuple[list[str], list[str], nn.Module, nn.Module]:
    """Keys that are read and made by the part without weights, this part, and the trunk behind it."""
    if not inputs:
        height, width, depth = image_shape
        return ["pixels"], ["image"], PoolPixels(pool), Trunk(height // pool, width // pool, depth, channels, features)
    images = [one.shape for one in inputs.values() if one.encoding == "image"]
    vector = sum(one.size for one in inputs.values() if one.encoding != "image")
    pooled = (images[0][0] // pool, images[0][1] // pool, sum(shape[2] for shape in images)) if images else None
    prepared = (["image"] if images else []) + (["vector"] if vector else [])
    return [*inputs], prepared, Prepare(inputs, pool), JoinedTrunk(pooled, vector, channels, features)
