"""Where tensors that take gigabytes fit."""

import torch


def with_room(device: torch.device, size: int) -> torch.device:
    """Return the device, or the CPU in place of a GPU half of whose free memory does not hold ``size`` bytes."""
    if device.type == "cuda" and size >= torch.cuda.mem_get_info(device)[0] // 2:
        return torch.device("cpu")
    return device
