"""Checkpoints, written so that a crash cannot leave a partial file."""

import io
import pickletools
import re
import shutil
import warnings
import zipfile
from pathlib import Path
from typing import Any

import torch

from splatrl.files import refusing, replacing

MADE = re.compile(r"collections OrderedDict|torch\._utils _rebuild_tensor_v2|torch \w+Storage|torch (Size|device)")
"""Objects that a checkpoint's pickle may create. PyTorch would also allow bytearrays, which can have any size."""

MOST_STEPS = 2**18
"""Maximum number of operations in a checkpoint's pickle; that of a large network and env has some thousands."""


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint atomically, so that ``path`` is never a partial file.

    Args:
        path: file to write.
        state: nested dicts and lists of tensors and plain values.

    Raises:
        OSError: if the file cannot be written; the message names the path.
    """
    memory = io.BytesIO()  # torch.save would report a full disk as an error of its own
    torch.save(state, memory)
    with replacing(path) as stream:
        stream.write(memory.getbuffer())


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint as data: tensors, on the CPU, and plain values, but no code.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is not a complete checkpoint.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected a checkpoint, found none")
    with refusing(path, "a complete checkpoint of tensors and plain values"):
        with zipfile.ZipFile(path) as archive:  # its checksums reveal damage that PyTorch would read as numbers
            _check_entries(archive, path.stat().st_size)
            damaged = archive.testzip()
        if damaged is not None:
            raise ValueError(f"{damaged} does not match its checksum")
        state = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(state, dict):
        raise ValueError(f"{path}: expected a checkpoint, got a {type(state).__name__}")
    return state


class Checkpoints:
    """The checkpoints of a run folder: the last one, the one before it, and that of the best policy.

    Args:
        folder: their folder, which is made.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.last, self.previous, self.best = (folder / f"{name}.pt" for name in ("last", "previous", "best"))
        folder.mkdir(parents=True, exist_ok=True)

    def save(self, state: dict[str, Any]) -> None:
        """Write the last checkpoint, keeping the one before it."""
        if self.last.exists():
            with replacing(self.previous) as stream, self.last.open("rb") as source:
                shutil.copyfileobj(source, stream)
        save_checkpoint(self.last, state)

    def newest(self, begun: bool) -> dict[str, Any] | None:
        """Read the last checkpoint or, with a warning, the one before it where that is damaged or missing.

        Args:
            begun: whether there are other traces of a training.

        Returns:
            Its state; None if there are no traces at all.

        Raises:
            ValueError: if there are traces, but no checkpoint that can be read.
        """
        if not (begun or any(path.exists() for path in (self.last, self.previous, self.best))):
            return None
        try:
            return load_checkpoint(self.last)
        except (FileNotFoundError, ValueError) as error:
            if not self.previous.exists():
                raise ValueError(f"{error}; there is no earlier checkpoint, so start again in a new folder") from error
            warnings.warn(f"{error}; resuming from the previous checkpoint, {self.previous.name}", stacklevel=3)
            state = load_checkpoint(self.previous)
            save_checkpoint(self.last, state)  # otherwise the next save would keep the damaged one as previous.pt
            return state


def _check_entries(archive: zipfile.ZipFile, size: int) -> None:
    """Refuse entries that unpack to more than the file's size, and pickles that create more than tensors and values."""
    entries = archive.infolist()
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
        raise ValueError("expected uncompressed entries, got compressed ones")
    if sum(entry.file_size for entry in entries) > size:
        raise ValueError(f"expected entries of at most {size:,} bytes in total, got more")
    for entry in entries:
        if entry.filename.endswith(".pkl"):
            made = _made(archive.read(entry))
            if strange := sorted(str(name) for name in made if not MADE.fullmatch(str(name))):
                raise ValueError(f"expected tensors and plain values, got {', '.join(strange)}")


def _made(pickled: bytes) -> set[object]:
    """Return the names of what a pickle creates; refuse one with more operations than any training needs."""
    made: set[object] = set()
    for number, (code, argument, _) in enumerate(pickletools.genops(pickled)):
        if code.name == "GLOBAL":
            made.add(argument)
        if number > MOST_STEPS:  # each takes a byte or more, and may create a list of 64 bytes
            raise ValueError(f"expected at most {MOST_STEPS:,} pickle operations, got more")
    return made
