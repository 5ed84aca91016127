"""The whole state of a fit in a file, from which one that was killed goes on with the same bytes."""

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

EVERY = 10.0
"""Seconds between two writings: 17 MB for 60,000 Gaussians with harmonics of degree 1."""


@dataclass
class Checkpoint:
    """A file in which a fit keeps its state now and then.

    Attributes:
        path: of the file, a .npz.
        digest: fingerprint of all that the bytes of the fit depend on; a file with another one is of another fit.
        every: seconds between two writings.
        say: told why a file is left out.
    """

    path: Path
    digest: str
    every: float = EVERY
    say: Callable[[str], object] = print

    def __post_init__(self) -> None:
        self._written = time.monotonic()

    def resume(self, restore: Callable[[dict[str, Tensor]], int]) -> int:
        """Hand what was kept to ``restore``, which raises for what is no state of its fit and returns the next step.

        Returns:
            The next step; 0 where nothing was kept, where it is of another fit, or where it is damaged.
        """
        try:
            arrays = read_arrays(self.path)
            if str(arrays.pop("digest", "")) != self.digest:
                return 0
            with refusing(self.path, "the state of a fit"):
                return restore({name: torch.from_numpy(values) for name, values in arrays.items()})
        except FileNotFoundError:
            return 0
        except (OSError, ValueError) as error:
            self.say(f"{error}; the fit begins anew")
            return 0

    def due(self) -> bool:
        """Whether it is time to write."""
        return time.monotonic() - self._written >= self.every

    def write(self, state: dict[str, Tensor]) -> None:
        """Keep a state, on the CPU, in place of the one before."""
        named: dict[str, Any] = {name: values.numpy() for name, values in state.items()}
        with replacing(self.path) as stream:
            np.savez(stream, digest=self.digest, **named)
        self._written = time.monotonic()

    def remove(self) -> None:
        """Forget what was kept."""
        self.path.unlink(missing_ok=True)
