"""Asymmetric actor-critic: extra observations that only the critic receives."""

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import ActorValueOperator

from splatrl.training.heads import orthogonal
from splatrl.training.inputs import Prepare
from splatrl.training.trunk import GAIN


class PreparedBeside(nn.Module):
    """The weight-free preparation of what actor and critic read.

    Args:
        own: the actor's preparation module.
        told: preparation of the vectors that only the critic receives.
    """

    def __init__(self, own: nn.Module, told: Prepare):
        super().__init__()
        self.own, self.told = own, told
        self.count = len(told.encodings)

    def forward(self, *observed: Tensor) -> tuple[Tensor, ...]:
        """Return the output of the actor's module, and the vector [..., V] for the critic."""
        own = self.own(*observed[: -self.count])
        return (*(own if isinstance(own, tuple) else (own,)), *self.told(*observed[-self.count :]))


class TrunkBeside(nn.Module):
    """The actor's trunk, followed by features for the critic, computed from the trunk's output and extra observations.

    Policy heads read only the first half of the output, the actor's.

    Args:
        own: the actor's trunk.
        vector: size of the vector that only the critic receives.
        features: size of each half of the output.
    """

    def __init__(self, own: nn.Module, vector: int, features: int):
        super().__init__()
        self.own = own
        self.joined = nn.Sequential(orthogonal(nn.Linear(features + vector, features), GAIN), nn.ReLU(inplace=True))

    def forward(self, *prepared: Tensor) -> Tensor:
        """Encode the output of ``PreparedBeside``: -> [..., 2 · features] float32."""
        own = self.own(*prepared[:-1])
        return torch.cat([own, self.joined(torch.cat([own, prepared[-1]], -1))], -1)


def actors_trunk(model: ActorValueOperator) -> TensorDictModuleBase:
    """Return the trunk of a model without what only serves its critic."""
    first, trunk, *memory = model.module[0].module
    if not isinstance(trunk.module, TrunkBeside):
        return model.module[0]
    count = first.module.count
    prepare = TensorDictModule(first.module.own, in_keys=first.in_keys[:-count], out_keys=first.out_keys[:-1])
    own = TensorDictModule(trunk.module.own, in_keys=trunk.in_keys[:-1], out_keys=trunk.out_keys)
    return TensorDictSequential(prepare, own, *memory)
