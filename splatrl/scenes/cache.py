"""A cache of arrays on disk: everything in it can be rebuilt."""

import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.array_files import Arrays, read_arrays
from splatrl.files import cache_dir, replacing


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
        return read_arrays(path, most)
    except FileNotFoundError:
        pass
    except (OSError, ValueError, MemoryError) as error:
        warnings.warn(f"{error}; this cache file is made again", stacklevel=2)
    arrays = build()
    named: dict[str, Any] = dict(arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as stream:
            (np.savez if most is None else np.savez_compressed)(stream, **named)
    except OSError as error:
        _warn_unwritable(path.parent, error.strerror)
    return arrays


@functools.cache
def _warn_unwritable(folder: Path, error: str | None) -> None:
    warnings.warn(f"{folder}: cannot keep caches here, set SPLATRL_CACHE to another folder: {error}", stacklevel=3)
