"""Errors that kernels record on the device and the host reads later, so that a step need not synchronise."""

from typing import Protocol, runtime_checkable

import torch

_CLEAR = torch.iinfo(torch.int32).max


@runtime_checkable
class Faulty(Protocol):
    """An object that records errors on its device."""

    def raise_faults(self) -> None:
        """Wait for the device, and raise any error recorded since the last call.

        Raises:
            ValueError: names the first row of a batch that was refused, and what was expected.
        """
        ...


class FaultFlag:
    """Records the lowest row of a batch that a kernel has refused.

    Attributes:
        flag: [1] int32 on the device; a kernel lowers it to the refused row (``atomicMin``).
    """

    def __init__(self, device: torch.device | str) -> None:
        self.flag = torch.full((1,), _CLEAR, dtype=torch.int32, device=device)

    def take(self) -> int | None:
        """Return the recorded row, or None, and clear the flag. Waits for the device."""
        row = int(self.flag)
        if row == _CLEAR:
            return None
        self.flag.fill_(_CLEAR)
        return row
