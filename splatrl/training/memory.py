"""A policy that remembers: a GRU whose state travels in the TensorDict."""

from torch import nn
from torchrl.data import Unbounded
from torchrl.envs import InitTracker, TensorDictPrimer, Transform
from torchrl.modules import GRUModule

STATE = "recurrent_state"


def gru(features: int, memory: int) -> GRUModule:
    """From ``features`` and ``recurrent_state`` to ``hidden`` and the next ``recurrent_state``.

    Args:
        features: size of the input.
        memory: size of state and output.
    """
    module = GRUModule(features, memory, in_keys=["features", STATE], out_keys=["hidden", ("next", STATE)])
    for name, parameter in module.gru.named_parameters():
        if name.startswith("weight"):
            nn.init.orthogonal_(parameter)
        else:
            nn.init.constant_(parameter, 0.0)
    return module


def memory_transforms(memory: int) -> list[Transform]:
    """What an env needs for ``actor_critic(..., memory=memory)``, in this order and after all other transforms.

    They carry ``recurrent_state`` [B, 1, memory] float32 from step to step, zero it where episodes begin, and say in
    ``is_init`` where that is.

    Args:
        memory: size of the state; of 0 nothing is needed.
    """
    if not memory:
        return []
    return [InitTracker(), TensorDictPrimer({STATE: Unbounded(shape=(1, memory))}, expand_specs=True)]
