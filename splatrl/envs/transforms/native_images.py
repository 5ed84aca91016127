"""Deciding whether the C++ core processes images, and on how many CPU cores."""

import torch
from torch import Tensor
from torch._C._functorch import is_functorch_wrapped_tensor

from splatrl.native.threads import usable_cores

LARGE = 16
"""Minimum number of images for which threads save more time than starting them costs."""


def in_core(images: Tensor) -> bool:
    """Return whether the C++ core can process images: it needs data in main memory, not tensors being traced."""
    return images.device.type == "cpu" and not torch.compiler.is_compiling() and not is_functorch_wrapped_tensor(images)


def cores_for(images: Tensor) -> int:
    """Return the number of CPU cores on which to process images [B, ...]."""
    return usable_cores() if len(images) >= LARGE else 1
