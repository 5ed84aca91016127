"""Files that appear whole or not at all, and the folder of those that can be rebuilt."""

import fcntl
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from hashlib import blake2b
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A binary file to write to, which takes the place of ``path`` once the block ends well.

    Until then it has a temporary name beside it; a block that raises leaves ``path`` as it was.
    """
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:  # a disk that is full says so without a name
        raise OSError(error.errno, f"cannot write: {error.strerror or error}", str(path)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_stale(folder: Path) -> None:
    """Remove temporary files that a killed process left in a folder, which no other process may be writing to."""
    for path in folder.iterdir():
        if re.fullmatch(r".+\.[0-9a-f]{8}\.tmp", path.name) and path.is_file():
            path.unlink()


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """A block in which no other process may be in the same block with the same folder.

    The system frees the folder when the process ends, however it ends.

    Raises:
        ValueError: where another process is.
    """
    held = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise ValueError(f"{folder}: expected an unused folder, but another process works there") from error
    finally:
        os.close(held)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Make a folder that gets its name only when the block succeeds; a block that raises leaves nothing behind.

    Raises:
        OSError: that names the path, where it cannot be written.
        ValueError: if something of that name exists.
    """
    if path.exists():
        raise ValueError(f"{path}: expected a new folder, found one")
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    temporary.mkdir()
    try:
        yield temporary
        os.rename(temporary, path)
    except OSError as error:  # a disk that is full says so without a name
        if error.errno is None:
            raise
        told = f"cannot write: {os.strerror(error.errno)}" if error.filename is None else error.strerror
        name = str(error.filename or path).replace(str(temporary), str(path))
        raise OSError(error.errno, told, name) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def require_room(folder: Path, size: int = 1) -> None:
    """Refuse to go on where nothing can be written into a folder, or its disk has not so many bytes left.

    What takes long asks before it begins; and what is written through mapped memory would end the process on a full
    disk, instead of raising an error.

    Raises:
        OSError: that names the folder.
    """
    try:
        with tempfile.TemporaryFile(dir=folder) as stream:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(stream.fileno(), 0, max(size, 1))
    except OSError as error:
        raise OSError(error.errno, f"cannot write: {os.strerror(error.errno or 0)}", str(folder)) from error


@contextmanager
def refusing(path: Path, expected: str) -> Iterator[None]:
    """Turn whatever a decoder raises for a damaged file into a ValueError that names the file.

    Decoders of images, archives and videos raise more than a dozen types, from IndexError to LZMAError. A file that is
    not there, a library that is missing and memory that runs out stay what they are.

    Args:
        path: of the file.
        expected: what it should have been, for the message.

    Raises:
        ValueError: for any other exception in the block.
    """
    try:
        yield
    except Exception as error:
        told = isinstance(error, ValueError) and f"{path}:" in str(error)
        if told or type(error) in (FileNotFoundError, ImportError, MemoryError):
            raise
        raise ValueError(f"{path}: expected {expected}, got {type(error).__name__}: {error}") from error


def checked_name(what: str, name: object) -> str:
    """Check a name of which files are made, which may come from a stranger: one part of a path, and not a way out.

    Args:
        what: what has the name, for the message.
        name: the name.

    Raises:
        ValueError: for anything but 1 to 200 characters without slashes and control characters, or for . and ..
    """
    plain = isinstance(name, str) and 0 < len(name) <= 200 and name not in (".", "..")
    if not plain or re.search(r"[/\\\x00-\x1f\x7f]", str(name)):
        raise ValueError(f"{what}: expected a name, without slashes, got {name!r:.200}")
    return str(name)


def digest_of(paths: Iterable[Path]) -> str:
    """Fingerprint of the content of small files, in this order."""
    digest = blake2b(digest_size=16)
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def natural(path: Path) -> list[tuple[int, str]]:
    """A sort key that puts 9.png before 10.png."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", path.name)]


def cache_dir() -> Path:
    """Where caches live: $SPLATRL_CACHE, or splatrl in $XDG_CACHE_HOME or ~/.cache."""
    chosen = os.environ.get("SPLATRL_CACHE")
    return Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "splatrl"
