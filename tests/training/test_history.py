"""The history of a training as tensors in its checkpoints."""

import math
from pathlib import Path

import pytest
import torch

from splatrl.training import load_checkpoint, save_checkpoint
from splatrl.training.history import packed, unpacked

ROWS = [{"frames": 64, "success": math.nan}, {"frames": 128, "success": 0.5, "test_success": 0.25}, {"loss": 1.5}]


def test_rows_come_back_with_their_keys_and_kinds_of_numbers() -> None:
    again = unpacked(packed(ROWS))
    assert [list(row) for row in again] == [list(row) for row in ROWS]
    assert repr(again) == repr(ROWS)  # 64 stays whole, and nan equals nan
    assert unpacked(packed([])) == []


def test_a_checkpoint_with_a_long_history_can_be_read(tmp_path: Path) -> None:
    history = [{f"key{number}": float(row) for number in range(14)} for row in range(20_000)]
    save_checkpoint(tmp_path / "last.pt", {"history": packed(history)})
    assert unpacked(load_checkpoint(tmp_path / "last.pt")["history"])[-1] == history[-1]


def test_rows_of_an_older_version_are_refused() -> None:
    with pytest.raises(ValueError, match="history: expected columns, got list; train the run again"):
        unpacked(ROWS)  # type: ignore[arg-type]


@pytest.mark.parametrize("rows", [[0, 2], [1], [-1, 0], [0, 2**40]])
def test_row_numbers_with_gaps_are_refused(rows: list[int]) -> None:
    with pytest.raises(ValueError, match="history: expected rows numbered from 0 without gaps"):
        unpacked({"frames": (torch.tensor(rows), torch.zeros(len(rows)))})
