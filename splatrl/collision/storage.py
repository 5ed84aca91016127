"""Arrays in an npz file, written whole and read with care."""

import math
import os
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from splatrl.files import replacing
from splatrl.scenes.cache import DAMAGED

MOST_COMPRESSED = 1032
"""Bytes that deflate can make of one."""


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to an npz file, which appears whole or not at all."""
    named: dict[str, Any] = dict(arrays)
    with replacing(Path(path)) as stream:
        np.savez_compressed(stream, **named)


def read_arrays(path: str | os.PathLike[str], names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Read arrays from an npz file, allocating no more than a file of its size can hold.

    Raises:
        FileNotFoundError: where there is no such file.
        ValueError: names the file, for one that is damaged or lacks an array.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            missing = [name for name in names if f"{name}.npy" not in archive.namelist()]
            if missing:
                raise ValueError(f"arrays named {', '.join(names)}, got none named {', '.join(missing)}")
            most = MOST_COMPRESSED * os.path.getsize(path)
            return {name: _read_array(archive, name, most) for name in names}
    except FileNotFoundError:
        raise
    except ValueError as error:
        raise ValueError(f"{path}: expected an npz file, got a damaged one: {error}") from error
    except (*DAMAGED, NotImplementedError, MemoryError) as error:
        raise ValueError(f"{path}: expected an npz file, got something else or a damaged one: {error}") from error


def _read_array(archive: zipfile.ZipFile, name: str, most: int) -> NDArray[Any]:
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as stream:
        shape, dtype = _read_header(stream)
        promised, held = math.prod(shape) * dtype.itemsize, info.file_size - stream.tell()
        if held > most:
            raise ValueError(f"{name}: expected at most {most} bytes in a file of this size, got {held}")
        if dtype.hasobject or promised != held:
            raise ValueError(f"{name}: expected {held} bytes of plain numbers, got a header for {promised} of {dtype}")
    with archive.open(info) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


def _read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    if version != (1, 0):
        raise ValueError(f"npy version 1.0 expected, got {version}")
    shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    return shape, dtype
