"""Errors that a device finds, and the host reads later: a step must not wait for them."""

from typing import Protocol, runtime_checkable

import torch

_CLEAR = torch.iinfo(torch.int32).max


@runtime_checkable
class Faulty(Protocol):
    """Something that records errors on its device."""

    def raise_faults(self) -> None:
        """Wait for the device, and raise the errors recorded since the last call.

        Raises:
            ValueError: names the first row of a batch that was refused, and what was expected.
        """
        ...


class FaultFlag:
    """The lowest row of any batch that a kernel refused.

    Attributes:
        flag: [1] int32 on the device; a kernel lowers it to the row (``atomicMin``).
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
