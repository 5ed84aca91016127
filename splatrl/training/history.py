"""The history of a training: as a few tensors, so that checkpoints stay small and quick to read, and as a table."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatrl.files import replacing

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


def write_table(path: Path, history: Sequence[Mapping[str, float]]) -> None:
    """Write rows as CSV, unless there are none."""
    if not history:
        return
    keys = list(dict.fromkeys(key for row in history for key in row))
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, keys)
    writer.writeheader()
    writer.writerows(history)
    with replacing(path) as stream:
        stream.write(table.getvalue().encode())


def _numbers(values: Sequence[float]) -> Tensor:
    whole = all(isinstance(value, int) for value in values)
    return torch.tensor(values, dtype=torch.int64 if whole else torch.float64)
