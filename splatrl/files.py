"""Atomic files and folders, damaged and untrusted files, and the cache folder."""

import copy
import errno
import fcntl
import os
import re
import secrets
import shutil
import tempfile
import warnings
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from hashlib import blake2b
from pathlib import Path
from typing import IO, BinaryIO


def expanded(path: str | os.PathLike[str]) -> Path:
    """Return a path with ``~`` replaced by a home folder; unchanged where it names no user, as ``~scan.ply`` does."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a binary file that replaces ``path`` atomically once the block succeeds.

    Until then it has a temporary name in the same folder, and is locked; if the block raises, ``path`` stays as it was.
    """
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as stream:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
            os.replace(temporary, path)
    except OSError as error:  # the error for a full disk names no file
        raise OSError(error.errno, f"cannot write: {error.strerror or error}", str(path)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_stale(folder: Path) -> None:
    """Remove what killed processes left of ``replacing``, ``new_folder`` and ``discard`` in a folder."""
    for path in folder.iterdir():
        temporary = re.fullmatch(r".+\.[0-9a-f]{8}\.tmp", path.name)
        if temporary and (path.is_file() or path.name.startswith(".")):
            _remove_abandoned(path)


def _remove_abandoned(path: Path) -> None:
    """Remove a temporary file or folder unless a process is still writing it; links stay, too."""
    with suppress(OSError):  # it is locked, or was renamed meanwhile, or its file system has no locks
        is_file = path.is_file()
        held = os.open(path, os.O_NOFOLLOW | (os.O_RDWR if is_file else os.O_RDONLY))  # NFS locks what can be written
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if is_file:
                path.unlink()
            else:
                shutil.rmtree(path)
        finally:
            os.close(held)


def discard(folder: Path) -> None:
    """Remove a folder that could be taken for unfinished work if a killed process left half of it."""
    aside = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}.tmp")
    os.rename(folder, aside)
    shutil.rmtree(aside)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Lock a folder, so that only one process of this machine at a time can be in this block for it.

    The system releases the lock when the process ends, however it ends.

    Raises:
        ValueError: if another process holds the lock.
    """
    held = os.open(folder, os.O_RDONLY)
    try:
        lock(held, folder)
        yield
    finally:
        os.close(held)


def lock(opened: int, folder: Path) -> None:
    """Lock an open file or folder until it is closed; warn where the file system has no locks, as Lustre may have none.

    Args:
        opened: its file descriptor.
        folder: the folder that the lock stands for, for the message.

    Raises:
        ValueError: if another process holds the lock.
    """
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ValueError(f"{folder}: expected an unused folder, got one that another process is using") from error
    except OSError as error:
        if error.errno not in (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK):
            raise
        warnings.warn(f"{folder}: its file system has no locks; let only one process at a time use it", stacklevel=3)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Make a folder that gets its name only when the block succeeds; a block that raises leaves nothing behind.

    Raises:
        OSError: if the folder cannot be written; the error names the path.
        ValueError: if the path exists already.
    """
    if path.exists():
        raise ValueError(f"{path}: expected a new folder, got one that already exists")
    with in_place_of(path, path.parent) as temporary:
        yield temporary
        os.rename(temporary, path)


@contextmanager
def in_place_of(path: Path, parent: Path) -> Iterator[Path]:
    """Make a temporary folder in ``parent`` for what is to get into the folder ``path``; the block moves its content.

    It is locked while the block runs, so those that killed processes left for the same path are known, and removed.

    Raises:
        OSError: if the folder cannot be written; the error names the path.
    """
    name = path.resolve().name
    temporary = parent / f".{name}.{secrets.token_hex(4)}.tmp"
    try:
        temporary.mkdir()
        with alone_in(temporary):
            for left in parent.glob(".*.tmp"):
                if re.fullmatch(rf"\.{re.escape(name)}\.[0-9a-f]{{8}}\.tmp", left.name):
                    _remove_abandoned(left)
            yield temporary
    except OSError as error:  # the error for a full disk names no file
        if error.errno is None:
            raise
        told = f"cannot write: {os.strerror(error.errno)}" if error.filename is None else error.strerror
        name = str(error.filename or path).replace(str(temporary), str(path))
        raise OSError(error.errno, told, name) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def require_room(folder: Path, size: int = 1) -> None:
    """Check that a folder is writable and that its disk has a number of bytes left.

    Long computations call this before they begin. So does code that writes through memory-mapped files, for which a
    full disk would kill the process instead of raising an error.

    Raises:
        OSError: if not; the error names the folder.
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

    Decoders of images, archives and videos raise more than a dozen exception types, from IndexError to LZMAError.
    Errors for a missing file, a missing library or a lack of memory pass through unchanged.

    Args:
        path: path of the file.
        expected: what the file should have been, for the message.

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


def open_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> IO[bytes]:
    """Open an entry of an untrusted ZIP archive as a stream whose ``read(n)`` unpacks about n bytes.

    ``read()`` without a number unpacks all that the data hold, whatever size the entry declares.

    Raises:
        ValueError: for a compression other than deflate, since others unpack as much as the data ask for.
        zipfile.BadZipFile, NotImplementedError or RuntimeError: if the entry is damaged or encrypted.
    """
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"expected stored or deflated data, got compression type {entry.compress_type}")
    return archive.open(entry)


def read_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, most: int) -> bytes:
    """Read an entry of an untrusted ZIP archive, never unpacking more than the size that it declares.

    Args:
        archive: the archive.
        entry: the entry.
        most: maximum size of the content, bytes.

    Raises:
        ValueError: if the entry declares more, holds another number of bytes than it declares, or as in ``open_entry``.
        zipfile.BadZipFile, NotImplementedError or RuntimeError: if the entry is damaged or encrypted.
    """
    size = entry.file_size
    if size > most:
        raise ValueError(f"expected at most {most:,} bytes, got {size:,}")
    one_more = copy.copy(entry)
    one_more.file_size += 1  # otherwise zipfile would cut surplus data without a word
    with open_entry(archive, one_more) as stream:
        content = stream.read(one_more.file_size)
    if len(content) != size:
        held = "more" if len(content) > size else f"{len(content):,}"
        raise ValueError(f"expected {size:,} bytes, as it declares, got {held}")
    return content


def checked_name(what: str, name: object) -> str:
    """Check an untrusted name that is used in file names: it must be one path component that stays in its folder.

    Args:
        what: the thing that is named, for the message.
        name: the name.

    Raises:
        ValueError: for anything but 1 to 200 bytes of UTF-8 without slashes or control characters, or for . and ..
    """
    size = len(str(name).encode(errors="replace"))  # file systems allow 255, also for names with endings
    if size > 200:
        raise ValueError(f"{what}: expected a name of at most 200 bytes, got {size} in {name!r:.60}")
    plain = isinstance(name, str) and name not in ("", ".", "..")
    if not plain or re.search(r"[/\\\x00-\x1f\x7f]", str(name)):
        raise ValueError(f"{what}: expected a name, without slashes, got {name!r:.200}")
    return str(name)


def digest_of(paths: Iterable[Path]) -> str:
    """Return a digest of the contents of files, in the given order."""
    digest = blake2b(digest_size=16)
    for path in paths:
        with path.open("rb") as stream:
            while block := stream.read(2**22):
                digest.update(block)
    return digest.hexdigest()


def natural(path: Path) -> list[tuple[int, str]]:
    """Return a sort key that puts 9.png before 10.png."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", path.name)]


def cache_dir() -> Path:
    """Return the folder for caches: $SPLATRL_CACHE, or splatrl in $XDG_CACHE_HOME or ~/.cache.

    Raises:
        ValueError: without either variable, for a user without a home folder, as in some containers.
    """
    if chosen := os.environ.get("SPLATRL_CACHE"):
        return expanded(chosen)
    if caches := os.environ.get("XDG_CACHE_HOME"):
        return Path(caches) / "splatrl"
    try:
        return Path.home() / ".cache" / "splatrl"
    except RuntimeError as error:
        raise ValueError(
            "SPLATRL_CACHE: expected a folder for caches where there is no home folder, got none"
        ) from error
