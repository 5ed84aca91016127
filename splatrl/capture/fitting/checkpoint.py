"""Checkpoint of a fit: its whole state in a file, from which a killed fit resumes with a bit-identical result."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatrl.array_files import read_arrays
from splatrl.files import refusing, replacing

CHECKPOINT = "checkpoint.npz"
EVERY = 10.0
"""Seconds between two writes; each takes 17 MB for 60,000 Gaussians with harmonics of degree 1."""


@dataclass
class Checkpoint:
    """A file to which a fit saves its state from time to time.

    Attributes:
        path: the file, a .npz.
        every: seconds between two writes.
        say: called with the reason where a file is ignored.
    """

    path: Path
    every: float = EVERY
    say: Callable[[str], object] = print

    def __post_init__(self) -> None:
        self._written = time.monotonic()

    def resume(self, restore: Callable[[dict[str, Tensor]], int]) -> int:
        """Pass the saved state to ``restore``, which returns the next step and raises for the state of another fit.

        Returns:
            The next step; 0 where nothing was saved, or where it is damaged.
        """
        try:
            arrays = read_arrays(self.path)
            with refusing(self.path, "a checkpoint of a fit"):
                return restore({name: torch.from_numpy(values) for name, values in arrays.items()})
        except FileNotFoundError:
            return 0
        except (OSError, ValueError) as error:
            self.say(f"{error}; the fit starts over")
            return 0

    def due(self) -> bool:
        """Return whether it is time to write."""
        return time.monotonic() - self._written >= self.every

    def write(self, state: dict[str, Tensor]) -> None:
        """Save a state, whose tensors are on the CPU, in place of the previous one."""
        named: dict[str, Any] = {name: values.numpy() for name, values in state.items()}
        with replacing(self.path) as stream:
            np.savez(stream, **named)
        self._written = time.monotonic()
