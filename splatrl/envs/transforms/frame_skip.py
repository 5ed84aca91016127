"""Frame skip: repeating each action for several env steps."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from splatrl.values import require_number


class FrameSkip(Transform):
    """Repeats each action for several env steps: the policy sees the last one and receives the sum of their rewards.

    A robot whose episode ends in between stops there. ``step_count`` and ``max_steps`` still count env steps.
    Transforms between the env and this one act in every step, those outside it once per action: camera noise belongs
    inside, frame stacking outside.

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
        if parent is not None:
            self._asked = tensordict.select(*parent.action_keys)
        return tensordict

    @torch.compiler.disable
    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        parent, asked = self.parent, self._asked
        if parent is None or asked is None:
            raise RuntimeError("FrameSkip: expected a parent env, found none; use it in a TransformedEnv")
        inputs = tensordict.exclude("next")
        for _ in range(self.steps - 1):
            last, done = next_tensordict, next_tensordict["done"]
            inputs = inputs.clone(False).update(last.exclude("reward")).update(asked)
            following = parent._step(inputs)
            following["reward"] = last["reward"] + following["reward"]
            values = {key: _rows(done, last[key], value) for key, value in following.items(True, True)}
            next_tensordict = last.clone(False).update(values)  # with what the policy wrote, such as its memory
        return next_tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Refuse data that does not come from an env."""
        raise RuntimeError("FrameSkip: expected a parent env, found none; use it in a TransformedEnv")


def _rows(mask: Tensor, chosen: Tensor, other: Tensor) -> Tensor:
    """Select rows of one tensor where a mask [*B, 1] is set, and of another elsewhere."""
    return torch.where(mask.view(*mask.shape, *[1] * (other.ndim - mask.ndim)), chosen, other)
