"""A cache of arrays on disk: everything in it can be rebuilt."""

import functools
import math
import os
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.array_files import Arrays, read_arrays
from splatrl.files import cache_dir, replacing

GIGABYTES = 16.0
"""That the cache may hold, unless $SPLATRL_CACHE_GB says something else."""
DAY = 24 * 3600.0
"""Seconds for which a file that was used is kept, whatever the cache holds."""


def cached_arrays(name: str, build: Callable[[], Arrays], most: int | None = None) -> Arrays:
    """Load the arrays cached under a name, or build them and cache them.

    A damaged file is rebuilt, with a warning. Where the folder cannot be written to, one warning is given and nothing
    is cached. Where the cache holds more than ``GIGABYTES``, or $SPLATRL_CACHE_GB, those of its arrays that were used
    longest ago are removed, of those that were not used for a day.

    Args:
        name: of the file, without its extension; it ends with a digest of everything that the arrays are made from, 32
            digits and letters.
        build: makes the arrays.
        most: bytes of the arrays at most, for a file that is compressed on disk; None for one that is not.

    Raises:
        ValueError: for a $SPLATRL_CACHE_GB that is no number from 0 on.
    """
    path = cache_dir() / f"{name}.npz"
    try:
        found = read_arrays(path, most)
        _mark_used(path)
        return found
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
        _make_room(path.parent, path.stat().st_size)
    except OSError as error:
        _warn_unwritable(path.parent, error.strerror)
    return arrays


def _mark_used(path: Path) -> None:
    """Let a file have been changed today: many systems do not note when a file was read."""
    with suppress(OSError):
        if time.time() - path.stat().st_mtime > DAY / 2:
            os.utime(path)


_unseen = math.inf
"""Bytes that this process has written since it looked at what the cache holds."""


def _make_room(folder: Path, written: int) -> None:
    """Remove arrays beyond what the cache may hold; looks at it now and then, as it may hold many files."""
    global _unseen
    limit = _limit()
    _unseen += written
    if _unseen < min(limit, 1e9) / 4:
        return
    _unseen = 0.0
    files = []
    for path in folder.glob(f"*-{'[0-9a-f]' * 32}.npz"):  # named by a digest, as all that is made here
        with suppress(FileNotFoundError):
            known = path.stat()
            files.append((known.st_mtime, known.st_size, path))
    held, now = sum(size for _, size, _ in files), time.time()
    for used, size, path in sorted(files):
        if held <= limit or now - used < DAY:
            break
        path.unlink(missing_ok=True)
        held -= size


def _limit() -> float:
    """Bytes that the cache may hold."""
    text = os.environ.get("SPLATRL_CACHE_GB") or str(GIGABYTES)
    try:
        limit = 1e9 * float(text)
    except ValueError:
        limit = math.nan
    if not limit >= 0:
        raise ValueError(f"SPLATRL_CACHE_GB: expected a number of gigabytes from 0 on, got {text!r}")
    return limit


@functools.cache
def _warn_unwritable(folder: Path, error: str | None) -> None:
    warnings.warn(f"{folder}: cannot keep caches here, set SPLATRL_CACHE to another folder: {error}", stacklevel=3)
