"""Converting a policy trained on ``task=strides`` into the gait that ``task=walk`` walks with."""

from torch import nn
from torchrl.modules import ActorValueOperator

from splatrl.motions.legs import FELT, JOINTS
from splatrl.physics.dense import Dense
from splatrl.training.asymmetric import actors_trunk
from splatrl.training.inputs import JoinedTrunk


def gait_of(model: ActorValueOperator) -> Dense:
    """Extract the dense layers that compute the most probable action of a policy that reads a single vector.

    Raises:
        ValueError: for a network that reads images, has memory, or does not control the quadruped's joints.
    """
    trunk, head = actors_trunk(model).module, model.get_policy_head().module[0].module
    linear = [layer for layer in head.modules() if isinstance(layer, nn.Linear)]
    joined = trunk[-1].module
    if not isinstance(joined, JoinedTrunk) or joined.seen is not None or joined.told is None or len(linear) != 1:
        raise ValueError("gait: expected a policy that reads only vectors and has no memory, got another")
    dense = [layer for layer in joined.modules() if isinstance(layer, nn.Linear)]
    layers = [(each.weight.detach(), each.bias.detach()) for each in dense]
    weight, bias = linear[0].weight.detach(), linear[0].bias.detach()
    found = Dense([*layers, (weight[: len(weight) // 2], bias[: len(bias) // 2])])  # means only
    if found.size != (FELT, JOINTS):
        raise ValueError(f"gait: expected {FELT} inputs and {JOINTS} outputs, got {found.size[0]} and {found.size[1]}")
    return found
