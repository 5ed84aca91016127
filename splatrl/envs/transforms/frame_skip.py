"""Frame skip: repeating each action for several env steps."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase, Transform

from splatrl.envs.nesting import layers
from splatrl.envs.restart import where_marked
from splatrl.envs.rules import DRAW, Draw
from splatrl.envs.splat_env import SplatEnv
from splatrl.envs.transforms.pose_noise import PoseNoise
from splatrl.values import require_number


class FrameSkip(Transform):
    """Repeats each action for several env steps: the policy sees the last one and receives the sum of their rewards.

    A robot whose episode ends in between stops there. ``step_count`` and ``max_steps`` still count env steps.
    Transforms between the env and this one act in every step, those outside it once per action: camera noise belongs
    inside, frame stacking outside.

    Views that nobody sees are not drawn: those between the first and the last step of an action, unless an episode ends
    there, the task judges by them, or a transform other than ``PoseNoise`` stands between the env and this one.

    It replaces TorchRL's ``FrameSkipTransform``, which repeats the step from the state before it: an env that keeps its
    state in the TensorDict would advance by one step and be rewarded for several.

    Args:
        steps: env steps per action.

    Raises:
        ValueError: for fewer than one step.
        RuntimeError: if used without an env.
    """

    def __init__(self, steps: int = 4):
        super().__init__()
        require_number("skip.steps", steps, 1, whole=True)
        self.steps = steps
        self._asked: TensorDictBase | None = None

    @torch.compiler.disable
    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Store the action before inner transforms change it; they change it anew in each repeated step."""
        parent = self.parent
        if parent is None:
            return tensordict
        self._asked = tensordict.select(*parent.action_keys, DRAW, strict=False)
        if self.steps > 1 and _draws_on_demand(parent):
            shape = (*parent.batch_size, 1)
            tensordict[DRAW] = torch.full(shape, Draw.AT_END, dtype=torch.int64, device=parent.device)
        return tensordict

    @torch.compiler.disable
    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        parent, asked = self.parent, self._asked
        if parent is None or asked is None:
            raise RuntimeError("FrameSkip: expected a parent env, found none; use it in a TransformedEnv")
        inputs = tensordict.exclude("next")
        for number in range(2, self.steps + 1):
            last, done = next_tensordict, next_tensordict["done"]
            inputs = inputs.clone(False).update(last.exclude("reward")).update(asked)
            if inputs.get(DRAW, None) is not None:
                needed = asked.get(DRAW, Draw.ALWAYS) if number == self.steps else Draw.AT_END
                inputs[DRAW] = torch.where(done, Draw.NEVER, needed)
            following = parent._step(inputs)
            following["reward"] = last["reward"] + following["reward"]
            values = {key: _where(done, last[key], value) for key, value in following.items(True, True)}
            next_tensordict = last.clone(False).update(values)  # with what the policy wrote, such as its memory
        return next_tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Refuse data that does not come from an env."""
        raise RuntimeError("FrameSkip: expected a parent env, found none; use it in a TransformedEnv")


def _draws_on_demand(env: EnvBase) -> bool:
    """Return whether an env leaves out views, and nothing around it reads them."""
    base, around = layers(env)
    inner = [one for each in around for one in each.transform.modules() if isinstance(one, Transform)]
    return isinstance(base, SplatEnv) and all(isinstance(one, Compose) or type(one) is PoseNoise for one in inner)


def _where(mask: Tensor, chosen: Tensor, other: Tensor) -> Tensor:
    """Select rows of one tensor where a mask [*B, 1] is set, and of another elsewhere."""
    batch = mask.ndim - 2
    return where_marked(mask.flatten(), chosen.flatten(0, batch), other.flatten(0, batch)).view(other.shape)
