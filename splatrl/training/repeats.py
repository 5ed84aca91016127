"""Frames that show the same, which a network needs to see only once."""

from collections.abc import Sequence

import torch
from torch import Tensor

SAMPLE = 128
"""So many frames tell whether a search among all is worth its time."""
LEAST_SHARE = 0.1
"""Of repeated frames, for which it is."""


def first_alike(*seen: Tensor) -> Tensor | None:
    """For each of N frames the first one that shows the same to the last bit.

    On a lattice a robot sees one of finitely many views, and a batch of frames shows each of them several times.

    Args:
        seen: what frames show, [N, ...] each, on a CPU.

    Returns:
        [N] int64, or None where hardly any of a sample are alike.
    """
    count = len(seen[0])
    sample = _first_alike([one[:: max(count // SAMPLE, 1)] for one in seen])
    if len(sample.unique()) > (1.0 - LEAST_SHARE) * len(sample):
        return None
    return _first_alike(seen)


def _first_alike(seen: Sequence[Tensor]) -> Tensor:
    arrays = [one.flatten(1).numpy() for one in seen]
    first: dict[tuple[bytes, ...], int] = {}
    rows = (tuple(array[row].tobytes() for array in arrays) for row in range(len(seen[0])))
    return torch.tensor([first.setdefault(shown, row) for row, shown in enumerate(rows)])
