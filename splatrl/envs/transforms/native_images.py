"""Deciding whether the C++ core processes images, and on how many CPU cores."""

from torch import Tensor

from splatrl.native.threads import usable_cores
from splatrl.native.tracing import traced

LARGE = 16
"""Minimum number of images for which threads save more time than starting them costs."""


def in_core(images: Tensor) -> bool:
    """Return whether the C++ core can process images: it needs data in main memory, not tensors being traced."""
    return images.device.type == "cpu" and not traced(images)


def cores_for(images: Tensor) -> int:
    """Return the number of CPU cores on which to process images [B, ...]."""
    return usable_cores() if len(images) >= LARGE else 1
