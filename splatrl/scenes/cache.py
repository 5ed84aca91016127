"""A cache of arrays on disk: everything in it can be rebuilt."""

import functools
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatrl.files import cache_dir, replacing

Arrays = dict[str, NDArray[Any]]

DAMAGED = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, KeyError, OSError, RuntimeError, ValueError)
"""What ``np.load`` raises for a damaged npz file."""


def cached_arrays(name: str, build: Callable[[], Arrays], compressed: bool = True) -> Arrays:
    """Load the arrays cached under a name, or build them and cache them.

    A damaged file is rebuilt, with a warning. Where the folder cannot be written to, one warning is given and nothing
    is cached.

    Args:
        name: of the file, without its extension; it holds a digest of everything that the arrays are made from.
        build: makes the arrays.
        compressed: whether the file on disk is compressed.
    """
    path = cache_dir() / f"{name}.npz"
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return dict(arrays)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except DAMAGED as error:
        warnings.warn(f"{path}: cannot read this cache file, rebuilding it: {error}", stacklevel=2)
    arrays = build()
    named: dict[str, Any] = dict(arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as stream:
            (np.savez_compressed if compressed else np.savez)(stream, **named)
    except OSError as error:
        _warn_unwritable(path.parent, error.strerror)
    return arrays


@functools.cache
def _warn_unwritable(folder: Path, error: str | None) -> None:
    warnings.warn(f"{folder}: cannot keep caches here, set SPLATRL_CACHE to another folder: {error}", stacklevel=3)
