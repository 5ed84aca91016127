"""Where tensors that take gigabytes fit."""

import torch


def with_room(device: torch.device, size: int) -> torch.device:
    """Return a device if half of its free memory, or main memory, holds ``size`` bytes, and else the CPU."""
    if device.type == "cuda" and size >= torch.cuda.mem_get_info(device)[0] // 2:
        return torch.device("cpu")
    return device
