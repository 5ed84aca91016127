"""A custom transform: TorchRL's own, applied to ``pixels``."""

import torch
from tensordict import TensorDictBase
from torchrl.envs import Transform


class Grey(Transform):
    """Removes the colour from what robots see."""

    def __init__(self) -> None:
        super().__init__(in_keys=["pixels"], out_keys=["pixels"])

    def _apply_transform(self, pixels: torch.Tensor) -> torch.Tensor:
        return pixels.float().mean(-1, keepdim=True).expand(pixels.shape).to(torch.uint8)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)
