"""The actor and critic, which read pixels or other observations."""

from collections.abc import Mapping, Sequence

from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.data import TensorSpec
from torchrl.modules import ActorValueOperator, ValueOperator

from splatrl.training.asymmetric import PreparedBeside, TrunkBeside
from splatrl.training.correlation import CorrelationTrunk
from splatrl.training.heads import FIRST_SCALE, orthogonal, policy_head
from splatrl.training.inputs import Input, JoinedTrunk, Prepare
from splatrl.training.memory import gru
from splatrl.training.trunk import PoolPixels, Trunk
from splatrl.values import require_number

FUSIONS = {"early": Trunk, "correlation": CorrelationTrunk}
"""Trunks that read several images, by the name of the fusion."""


def actor_critic(
    image_shape: Sequence[int],
    action_spec: TensorSpec,
    pool: int = 2,
    channels: Sequence[int] = (16, 32),
    features: int = 128,
    memory: int = 0,
    inputs: Mapping[str, Input] | None = None,
    critic_inputs: Mapping[str, Input] | None = None,
    spread: float = FIRST_SCALE,
    fusion: str = "early",
) -> ActorValueOperator:
    """Make actor and critic over one trunk: ``pixels`` -> ``image`` -> ``hidden`` -> ``action`` and ``state_value``.

    With ``inputs``, those are read in place of ``pixels``, and encoded as ``image`` and ``vector``. With
    ``critic_inputs``, the critic receives more than the actor (Pinto et al. 2018, "Asymmetric Actor Critic"): where
    robots really are, or what they cannot feel. The actor's output does not depend on them.

    Args:
        image_shape: (H, W, C), where C is 3 for each stacked frame.
        action_spec: action spec of the env, batched or not; see ``policy_head``.
        pool: see ``PoolPixels``.
        channels: see ``Trunk``.
        features: see ``Trunk``.
        memory: size of the state of a GRU between trunk and heads, for which the env needs
            ``memory_transforms(memory)``; 0 for no GRU.
        inputs: observations to read in place of pixels, by key; see ``inputs_of``.
        critic_inputs: vectors that only the critic reads as well, by key.
        spread: initial standard deviation of continuous actions, see ``policy_head``.
        fusion: one of ``FUSIONS``, how several images are combined: joined as channels (``early``) or, if there are two
            of the same shape, compared (``correlation``, see ``CorrelationTrunk``).

    Returns:
        Operator whose ``get_policy_operator()`` acts, and whose heads share the trunk's ``hidden``.

    Raises:
        ValueError: if a size is not a whole number in its range; if the fusion is unknown or does not suit the images;
            or if the critic's inputs are images, are read by the actor, or come with a memory.
    """
    require_number("network.pool", pool, 1, whole=True)
    require_number("network.features", features, 1, whole=True)
    require_number("network.memory", memory, 0, whole=True)
    require_number("network.spread", spread, 0.02, 10.0)
    for count in channels:
        require_number("network.channels", count, 1, whole=True)
    reads, prepared, prepare, trunk = _reader(image_shape, pool, channels, features, inputs, fusion)
    known = wide = memory or features
    if critic_inputs:
        if memory:
            raise ValueError(f"critic_inputs: expected none for a policy with memory, got {', '.join(critic_inputs)}")
        told = Prepare(critic_inputs, 1)
        if twice := set(critic_inputs) & set(reads):
            raise ValueError(
                f"critic_inputs: expected observations that the actor does not read, got {', '.join(sorted(twice))}"
            )
        if images := [key for key, one in critic_inputs.items() if one.encoding == "image"]:
            raise ValueError(f"critic_inputs.{images[0]}: expected plain, angle or polar, got image")
        reads, prepared, wide = [*reads, *critic_inputs], [*prepared, "critic_vector"], 2 * features
        prepare = PreparedBeside(prepare, told)
        trunk = TrunkBeside(trunk, sum(one.size for one in critic_inputs.values()), features)
    seen = "features" if memory else "hidden"
    layers: list[TensorDictModuleBase] = [
        TensorDictModule(prepare, in_keys=reads, out_keys=prepared),
        TensorDictModule(trunk, in_keys=prepared, out_keys=[seen]),
    ]
    if memory:
        layers.append(gru(features, memory))
    value = ValueOperator(orthogonal(nn.Linear(wide, 1), 1.0), in_keys=["hidden"])
    return ActorValueOperator(
        TensorDictSequential(*layers), policy_head(action_spec, known, wide > known, spread), value
    )


def _reader(
    image_shape: Sequence[int],
    pool: int,
    channels: Sequence[int],
    features: int,
    inputs: Mapping[str, Input] | None,
    fusion: str,
) -> tuple[list[str], list[str], nn.Module, nn.Module]:
    """Return the keys that the weight-free part reads and writes, that part, and the trunk that follows it."""
    if fusion not in FUSIONS:
        raise ValueError(f"network.fusion: expected one of {', '.join(FUSIONS)}, got {fusion}")
    images = [one.shape for one in (inputs or {}).values() if one.encoding == "image"]
    if fusion != "early" and (len(images) != 2 or images[0] != images[1]):
        raise ValueError(
            f"network.fusion: expected early unless the policy reads exactly two images of the same shape, got "
            f"{fusion} for {len(images)} images"
        )
    if not inputs:
        height, width, depth = image_shape
        return ["pixels"], ["image"], PoolPixels(pool), Trunk(height // pool, width // pool, depth, channels, features)
    vector = sum(one.size for one in inputs.values() if one.encoding != "image")
    pooled = (images[0][0] // pool, images[0][1] // pool, sum(shape[2] for shape in images)) if images else None
    prepared = (["image"] if images else []) + (["vector"] if vector else [])
    return [*inputs], prepared, Prepare(inputs, pool), JoinedTrunk(pooled, vector, channels, features, FUSIONS[fusion])
