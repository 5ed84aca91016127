"""Whether, and on how many cores, the C++ core changes images."""

import torch
from torch import Tensor
from torch._C._functorch import is_functorch_wrapped_tensor

from splatrl.native.threads import usable_cores

LARGE = 16
"""From so many images on, starting threads costs less than they save."""


def in_core(images: Tensor) -> bool:
    """Whether the core can read images: it needs numbers in main memory, which tracers do not have."""
    return images.device.type == "cpu" and not torch.compiler.is_compiling() and not is_functorch_wrapped_tensor(images)


def cores_for(images: Tensor) -> int:
    """Cores to change images on, [B, ...]."""
    return usable_cores() if len(images) >= LARGE else 1
