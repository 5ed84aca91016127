"""The device of all tensors, chosen once at a program's entry point."""

from importlib.util import find_spec

import torch

AUTO = "auto"
KINDS = ("cpu", "cuda")
"""Device types for which config groups may have a node."""


def chosen_device(name: str) -> torch.device:
    """Return the device with a name; a numbered GPU also becomes PyTorch's current device.

    Args:
        name: ``auto`` takes a CUDA device if there is one and the extra ``cuda`` is installed, otherwise the CPU; any
            other name is PyTorch's, such as cpu or cuda:1.

    Raises:
        ValueError: for a name that PyTorch does not know, or a CUDA device that this machine lacks.
    """
    if name == AUTO:
        return torch.device("cuda" if torch.cuda.is_available() and cuda_extra() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ValueError(f"device: expected auto, cpu, cuda or cuda:<number>, got {name}") from error
    if device.type == "cuda":
        if (device.index or 0) >= torch.cuda.device_count():
            raise ValueError(
                f"device: expected a device of this machine, got {name}, but PyTorch {torch.__version__} finds "
                f"{torch.cuda.device_count()} CUDA devices; device=auto selects an available device"
            )
        if device.index is not None:
            torch.cuda.set_device(device)
    return device


def device_line(device: torch.device) -> str:
    """Describe the chosen device in one line."""
    if device.type == "cuda":
        return f"device: {device} ({torch.cuda.get_device_name(device)})"
    if torch.cuda.is_available() and not cuda_extra():
        return f"device: {device}; for {torch.cuda.get_device_name()}: pip install 'splatrl[cuda]'"
    return f"device: {device}"


def cuda_extra() -> bool:
    """Whether the extra ``cuda`` is installed."""
    return find_spec("cuda") is not None and find_spec("cuda.core") is not None
