"""Safe reading of .npz files: no file can run code, or claim more memory than the arrays it holds."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatrl.files import open_entry, refusing

Arrays = dict[str, NDArray[Any]]


def read_arrays(path: Path, most: int | None = None) -> Arrays:
    """Read the arrays of a .npz file.

    Args:
        path: path of the file.
        most: maximum total size of the arrays in bytes, for a compressed file; None for an uncompressed one, whose
            arrays cannot be larger than the file.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for anything but a complete .npz of plain arrays, or for arrays larger than that.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such .npz file")
    with refusing(path, "a complete .npz of plain arrays"):
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            held, limit = sum(entry.file_size for entry in entries), path.stat().st_size if most is None else most
            if held > limit:
                raise ValueError(f"expected at most {limit:,} bytes of arrays, got {held:,}")
            for entry in entries:
                _check_entry(archive, entry)
        with np.load(path, allow_pickle=False) as arrays:
            return dict(arrays)


def _check_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
    """Refuse an array whose header promises more data than follows: NumPy would allocate it before reading."""
    with open_entry(archive, entry) as stream:
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(stream)
        held = entry.file_size - stream.tell()
    promised = dtype.itemsize
    for side in shape:
        promised *= side
    if dtype.hasobject or promised != held:
        raise ValueError(f"{entry.filename}: expected {dtype} {shape}, {promised:,} bytes, got {held:,}")
