"""Frame stacking: the last few views, concatenated along the channel axis."""

import torch
from tensordict import TensorDictBase
from torch.nn.parameter import UninitializedBuffer
from torchrl.envs import CatFrames


class FrameStack(CatFrames):
    """TorchRL's ``CatFrames`` for [B, H, W, C] images; an episode begins with its first view repeated.

    Unlike ``CatFrames``, it never synchronises with the host to find out where episodes begin.

    Args:
        N: number of views.
        in_keys: keys of the images.
        dim: channel axis; only -1, the last one, is supported.

    Raises:
        ValueError: for any other axis.
    """

    def __init__(self, N: int, in_keys: tuple[str, ...] = ("pixels",), dim: int = -1):
        if dim != -1:
            raise ValueError(f"stack.dim: expected -1, the channel axis, got {dim}")
        super().__init__(N, dim, in_keys=list(in_keys))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        mask = tensordict.get("_reset", None)
        for key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            view, name = tensordict_reset[key], f"_cat_buffers_{key}"
            stack = getattr(self, name)
            if isinstance(stack, UninitializedBuffer):
                stack = self._make_missing_buffer(view, name)
            begun = torch.cat([view] * self.N, -1)
            stack.copy_(begun if mask is None else torch.where(mask.view(*mask.shape, 1, 1), begun, stack))
            tensordict_reset.set(out_key, stack.clone())
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        mask = tensordict.get("_step", None)
        if mask is None:
            return super()._step(tensordict, next_tensordict)
        stacks = [getattr(self, f"_cat_buffers_{key}") for key in self.in_keys]
        before = [stack.clone() for stack in stacks]
        after = super()._step(tensordict, next_tensordict)
        for stack, old in zip(stacks, before, strict=True):  # robots that wait see nothing new
            stack.copy_(torch.where(mask.view(*mask.shape, 1, 1), stack, old))
        return after
