"""A cache of arrays on disk: everything in it can be rebuilt."""

import functools
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatrl.files import cache_dir, replacing

Arrays = dict[str, NDArray[Any]]


def cached_arrays(name: str, build: Callable[[], Arrays], most: int | None = None) -> Arrays:
    """Load the arrays cached under a name, or build them and cache them.

    A damaged file is rebuilt, with a warning. Where the folder cannot be written to, one warning is given and nothing
    is cached.

    Args:
        name: of the file, without its extension; it holds a digest of everything that the arrays are made from.
        build: makes the arrays.
        most: bytes of the arrays at most, for a file that is compressed on disk; None for one that is not.
    """
    path = cache_dir() / f"{name}.npz"
    try:
        _check_size(path, most)
        with np.load(path, allow_pickle=False) as arrays:
            return dict(arrays)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except Exception as error:  # zipfile and np.load raise more than a dozen types for damaged files
        warnings.warn(f"{path}: cannot read this cache file, rebuilding it: {error}", stacklevel=2)
    arrays = build()
    named: dict[str, Any] = dict(arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as stream:
            (np.savez if most is None else np.savez_compressed)(stream, **named)
    except OSError as error:
        _warn_unwritable(path.parent, error.strerror)
    return arrays


def _check_size(path: Path, most: int | None) -> None:
    """Refuse a file that holds more than it may, before any of it is read."""
    with zipfile.ZipFile(path) as archive:
        held = sum(entry.file_size for entry in archive.infolist())
    limit = path.stat().st_size if most is None else most
    if held > limit:
        raise ValueError(f"expected at most {limit:,} bytes of arrays, got {held:,}")


@functools.cache
def _warn_unwritable(folder: Path, error: str | None) -> None:
    warnings.warn(f"{folder}: cannot keep caches here, set SPLATRL_CACHE to another folder: {error}", stacklevel=3)
