"""Checkpoints that a crash cannot leave half-written."""

import zipfile
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from splatrl.files import replacing


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint atomically, so that ``path`` is never a partial file.

    Args:
        path: file to write.
        state: nested dicts and lists of tensors and plain values.
    """
    with replacing(path) as stream:
        torch.save(state, stream)


def load_checkpoint(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read a checkpoint as data: tensors and plain values, but no code.

    Raises:
        FileNotFoundError: if there is none.
        ValueError: if the file is not a complete checkpoint.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected a checkpoint, found none")
    try:
        with zipfile.ZipFile(path) as archive:  # its checksums find damage that PyTorch would read as numbers
            damaged = archive.testzip()
        if damaged is not None:
            raise ValueError(f"the checksum of {damaged} differs")
        state = torch.load(path, map_location=device, weights_only=True)
    except (zipfile.BadZipFile, RuntimeError, UnpicklingError, EOFError, OSError, ValueError) as error:
        raise ValueError(f"{path}: expected a whole checkpoint of tensors and plain values: {error}") from error
    if not isinstance(state, dict):
        raise ValueError(f"{path}: expected a checkpoint, found a {type(state).__name__}")
    return state
