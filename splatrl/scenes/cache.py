"""A disk cache of arrays and generated towns, all of which can be rebuilt."""

import functools
import math
import os
import shutil
import time
import warnings
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.array_files import Arrays, read_arrays
from splatrl.files import cache_dir, replacing
from splatrl.waits import announced

GIGABYTES = 16.0
"""Maximum size of the cache in gigabytes, unless $SPLATRL_CACHE_GB sets another one."""
DIGEST = "[0-9a-f]" * 32
OURS = f"*-{DIGEST}.npz", f"town-*-{DIGEST}"
"""Names of the files and folders that may be removed: they end with a digest, as do all that are written here."""
LEFT = f"*-{DIGEST}.npz.*.tmp", f"town-*-{DIGEST}/*.tmp"
"""Names of the temporary files that processes leave which are killed while they write."""
DAY = 24 * 3600.0
"""Seconds for which a file is kept after its last use, even if the cache exceeds its limit."""


def cached_arrays(name: str, build: Callable[[], Arrays], most: int | None = None, what: str | None = None) -> Arrays:
    """Load the arrays cached under a name, or build them and cache them.

    A damaged file is rebuilt, with a warning. If the folder is not writable, one warning is given and nothing is
    cached. If the cache exceeds ``GIGABYTES``, or $SPLATRL_CACHE_GB, the least recently used arrays and towns are
    removed, except those used within the last day.

    Args:
        name: file name without its extension; it ends with a digest of everything that the arrays are made from, 32
            hexadecimal digits.
        build: callback that builds the arrays.
        most: maximum total size of the arrays in bytes, for a file that is compressed on disk; None for an uncompressed
            file.
        what: what people are told is being computed if that takes long; None where something else shows it.

    Raises:
        ValueError: if $SPLATRL_CACHE_GB is not a number of at least 0.
    """
    path = cache_dir() / f"{name}.npz"
    try:
        found = read_arrays(path, most)
        mark_used(path)
        return found
    except FileNotFoundError:
        pass
    except (OSError, ValueError, MemoryError) as error:
        warnings.warn(f"{error}; rebuilding this cache file", stacklevel=2)
    told = f"computing {what}, which takes long only once: the result is kept in {path.parent}"
    with announced(told) if what is not None else nullcontext():
        arrays = build()
    named: dict[str, Any] = dict(arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as stream:
            (np.savez if most is None else np.savez_compressed)(stream, **named)
        make_room(path.parent, path.stat().st_size)
    except OSError as error:
        _warn_unwritable(path.parent, error.strerror)
    return arrays


def mark_used(path: Path) -> None:
    """Update the modification time of a file or folder, which is its last use: many systems track no access times."""
    with suppress(OSError):
        if time.time() - path.stat().st_mtime > DAY / 2:
            os.utime(path)


_unseen = math.inf
"""Bytes written by this process since it last measured the cache."""


def make_room(folder: Path, written: int) -> None:
    """Remove what the cache holds beyond its limit; it is scanned only now and then, as it may hold many files.

    Args:
        folder: folder of the cache.
        written: number of bytes that were added to it.

    Raises:
        ValueError: if $SPLATRL_CACHE_GB is not a number of at least 0.
    """
    global _unseen
    limit = _limit()
    _unseen += written
    if _unseen < min(limit, 1e9) / 4:
        return
    _unseen = 0.0
    _remove_left(folder)
    found = []
    for path in (path for pattern in OURS for path in folder.glob(pattern)):
        with suppress(FileNotFoundError):
            found.append((path.stat().st_mtime, size_of(path), path))
    held, now = sum(size for _, size, _ in found), time.time()
    for used, size, path in sorted(found):
        if held <= limit or now - used < DAY:
            break
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        held -= size


def _remove_left(folder: Path) -> None:
    """Remove the temporary files that have not been written to for a day, since a process is no longer writing them."""
    for path in (path for pattern in LEFT for path in folder.glob(pattern)):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > DAY:
                path.unlink()


def size_of(path: Path) -> int:
    """Return the size of a file, or of the files in a folder, in bytes."""
    return sum(one.stat().st_size for one in (path.iterdir() if path.is_dir() else [path]))


def _limit() -> float:
    """Return the maximum size of the cache in bytes."""
    text = os.environ.get("SPLATRL_CACHE_GB") or str(GIGABYTES)
    try:
        limit = 1e9 * float(text)
    except ValueError:
        limit = math.nan
    if not limit >= 0:
        raise ValueError(f"SPLATRL_CACHE_GB: expected a non-negative number of gigabytes, got {text!r}")
    return limit


@functools.cache
def _warn_unwritable(folder: Path, error: str | None) -> None:
    warnings.warn(f"{folder}: cannot write the cache here: {error}; set SPLATRL_CACHE to another folder", stacklevel=3)
