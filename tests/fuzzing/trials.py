"""Tries damaged files: counts what became of them, and tells what must never happen."""

import contextlib
import json
import os
import random
import re
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from mmap import mmap
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tests.fuzzing.formats import FORMATS, Format

SLOW = 5.0
"""Seconds of a processor that a file may take."""
STUCK = 12 * SLOW
"""Seconds of a processor after which the process of a file is ended; so many minutes pass where it only waits."""
FIXED, EACH = 100 * 2**20, 4
"""Bytes of memory that reading a file may take, and how many more for each byte of what it holds in float32."""
HEADERS = re.compile(
    r"header: |a header|magic: |version: |a ZIP bundle|File is not a zip|cannot identify|InvalidDataError|YAML|JSON|UTF"
    r"|got BadZipFile|ZIP archive|expected XML|expected LZFSE|a complete gzip|Failed to open|expected a COLMAP model"
)
"""Words of errors that come before the content of a file is reached."""


@dataclass
class Counts:
    """What became of the files of a format.

    Attributes:
        read: without an error.
        header: refused before their content was reached.
        behind: refused behind that.
        slowest: seconds of a processor that a file took.
        memory: bytes that a file took at most, beyond what it holds (``EACH`` times in float32).
        faults: number of the file, and what happened that must not.
    """

    read: int = 0
    header: int = 0
    behind: int = 0
    slowest: float = 0.0
    memory: int = 0
    faults: list[tuple[int, str]] = field(default_factory=list)

    @property
    def tried(self) -> int:
        """The number of files."""
        return self.read + self.header + self.behind + len(self.faults)

    def add(self, other: "Counts") -> None:
        """Add those of more files."""
        self.read, self.header = self.read + other.read, self.header + other.header
        self.behind, self.faults = self.behind + other.behind, self.faults + other.faults
        self.slowest, self.memory = max(self.slowest, other.slowest), max(self.memory, other.memory)


def content(kind: Format, seed: int, number: int) -> bytes:
    """A damaged file; the seed and its number say which."""
    rng = random.Random(f"{seed} {number}")
    return kind.damage(rng.choice(kind.wholes), rng)


def try_files(kind: Format, count: int, seed: int, folder: Path, first: int = 0, at: mmap | None = None) -> Counts:
    """Read damaged files of a format in this process.

    Args:
        kind: the format.
        count: of the files.
        seed: of all of them.
        folder: an empty one, to work in.
        first: number of the first file.
        at: where to write the number of each file before it is read.
    """
    kind.around(folder)
    path, counts = folder / kind.name, Counts()
    assert kind.wholes  # made before anything is measured
    for number in range(first, first + count):
        path.write_bytes(content(kind, seed, number))
        if at is not None:
            at[:8] = number.to_bytes(8, "little")
            signal.setitimer(signal.ITIMER_PROF, STUCK)
            signal.alarm(round(60 * STUCK))
        _try(kind, path, number, counts)
    if at is not None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.alarm(0)
    return counts


def _try(kind: Format, path: Path, number: int, counts: Counts) -> None:
    """Read one file and count it."""
    before = _resident("VmRSS") if _WATCHED else 0
    if _WATCHED:
        Path("/proc/self/clear_refs").write_text("5")
    began, found, read = time.process_time(), "read", None
    try:
        with warnings.catch_warnings(), _silent():
            warnings.simplefilter("ignore")
            read = kind.read(path)
    except ValueError as error:
        found = "header" if HEADERS.search(str(error)) else "behind"
        if str(path.parent).partition("/keyframes")[0].removesuffix("/memmap") not in str(error):
            found = f"an error that names no file: {error}"
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        found = f"expected a ValueError, got {type(error).__name__}: {error!s:.200} ({where.filename}:{where.lineno})"
    taken = time.process_time() - began
    memory = (_resident("VmHWM") - before if _WATCHED else 0) - EACH * held(read)
    counts.slowest, counts.memory = max(counts.slowest, taken), max(counts.memory, memory)
    if taken > SLOW:
        found = f"{taken:.1f} s"
    elif memory > FIXED:
        found = f"{memory / 2**20:.0f} MiB of memory, {found}"
    if found in ("read", "header", "behind"):
        setattr(counts, found, getattr(counts, found) + 1)
    else:
        counts.faults.append((number, found))


_WATCHED = sys.platform.startswith("linux")


def _resident(name: str) -> int:
    """Bytes of memory, as Linux counts them."""
    status = Path("/proc/self/status").read_bytes()
    at = status.index(name.encode()) + len(name) + 1
    return 1024 * int(status[at : at + 20].split()[0])


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Nothing is shown of what readers print by Python."""
    with contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):
        yield


def held(value: Any) -> int:
    """Bytes of all numbers in a value, as float32."""
    if isinstance(value, torch.Tensor):
        return 4 * value.numel()
    if isinstance(value, np.ndarray):
        return 4 * value.size
    if hasattr(value, "getbands"):
        return 4 * value.width * value.height * len(value.getbands())
    if hasattr(value, "values") and not isinstance(value, type):
        return sum(map(held, value.values()))
    if hasattr(value, "__dict__") and not isinstance(value, type):
        return sum(map(held, vars(value).values()))
    return sum(map(held, value)) if isinstance(value, list | tuple) else 0


def try_apart(name: str, count: int, seed: int, folder: Path, first: int = 0) -> Counts:
    """Read damaged files of a format in processes of their own, which a file may end.

    Args:
        name: of the format.
        count: of the files.
        seed: of all of them.
        folder: to work in.
        first: number of the first file.
    """
    counts, last = Counts(), first + count
    while first < last:
        at = mmap(-1, 8)
        at[:8] = first.to_bytes(8, "little")
        told, tell = os.pipe()
        child = os.fork()
        if child == 0:
            _tell(tell, name, last - first, seed, folder, first, at)
        os.close(tell)
        with open(told, "rb") as stream:
            said = stream.read()
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if said and status == 0:
            counts.add(Counts(**_plain(json.loads(said))))
            return counts
        number = int.from_bytes(at[:8], "little")
        # the counts of those before are lost with the process, so these are tried again without it
        if number > first:
            counts.add(try_apart(name, number - first, seed, folder, first))
        ended = signal.Signals(-status).name if status < 0 else f"exit status {status}"
        counts.faults.append((number, f"ended the process: {ended}"))
        first = number + 1
    return counts


def _plain(found: Mapping[str, Any]) -> dict[str, Any]:
    return {**found, "faults": [(number, text) for number, text in found["faults"]]}


def _tell(tell: int, name: str, count: int, seed: int, folder: Path, first: int, at: mmap) -> None:
    """Try files in this process, write what became of them into a pipe, and end."""
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        place = folder / f"{os.getpid()}"
        place.mkdir()
        counts = try_files(FORMATS[name], count, seed, place, first, at)
        os.write(tell, json.dumps(asdict(counts)).encode())
        os._exit(0)
    finally:
        os._exit(1)
