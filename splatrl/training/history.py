"""The history of a training as a few tensors, so that a checkpoint of a long one stays small and quick to read."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

Packed = dict[str, tuple[Tensor, Tensor]]
"""By key, the rows that have it, [n] int64, and its values there, [n] int64 or float64."""


def packed(history: Sequence[Mapping[str, float]]) -> Packed:
    """Convert rows of numbers to columns; whole numbers stay whole."""
    columns: dict[str, tuple[list[int], list[float]]] = {}
    for number, row in enumerate(history):
        for key, value in row.items():
            rows, values = columns.setdefault(key, ([], []))
            rows.append(number)
            values.append(value)
    return {key: (torch.tensor(rows), _numbers(values)) for key, (rows, values) in columns.items()}


def unpacked(columns: Mapping[str, Any]) -> list[dict[str, float]]:
    """Convert columns back to rows.

    Raises:
        ValueError: for anything but columns, or for row numbers with gaps, which a damaged or hostile file could make
            arbitrarily large.
    """
    if not isinstance(columns, Mapping):  # as in checkpoints of versions that stored rows
        raise ValueError(f"history: expected columns, got {type(columns).__name__}; train the run again")
    numbers = torch.cat([rows for rows, _ in columns.values()]).unique() if columns else torch.empty(0)
    if not torch.equal(numbers, torch.arange(len(numbers)).to(numbers)):
        raise ValueError("history: expected rows numbered from 0 without gaps, got others")
    history: list[dict[str, float]] = [{} for _ in range(len(numbers))]
    for key, (rows, values) in columns.items():
        for row, value in zip(rows.tolist(), values.tolist(), strict=True):
            history[row][key] = value
    return history


def _numbers(values: Sequence[float]) -> Tensor:
    whole = all(isinstance(value, int) for value in values)
    return torch.tensor(values, dtype=torch.int64 if whole else torch.float64)
