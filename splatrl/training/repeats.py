"""Identical frames, which a network needs to evaluate only once."""

from collections.abc import Sequence

import torch
from torch import Tensor

SAMPLE = 128
"""Number of frames that are sampled to decide whether a search among all is worth its time."""
LEAST_SHARE = 0.1
"""Minimum fraction of repeated frames in the sample for a search among all."""


def first_alike(*seen: Tensor) -> Tensor | None:
    """Return, for each of N frames, the first one with bitwise identical inputs.

    On a lattice, a robot sees one of finitely many views, and a batch of frames holds each of them several times.

    Args:
        seen: inputs of the frames, [N, ...] each, on a CPU.

    Returns:
        [N] int64, or None if hardly any frames of a sample are identical.
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
