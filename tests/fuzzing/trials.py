"""Trials of damaged files: count the outcomes, and detect what must never happen."""

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
"""Maximum CPU seconds per file."""
STUCK = 12 * SLOW
"""CPU seconds after which the process that reads a file is killed; after as many minutes if it only waits."""
FIXED, EACH = 100 * 2**20, 4
"""Bytes of memory that reading a file may take, plus bytes per byte of its content as float32."""
HEADERS = re.compile(
    r"header: |a header|magic: |version: |a ZIP bundle|File is not a zip|cannot identify|InvalidDataError|YAML|JSON|UTF"
    r"|got BadZipFile|ZIP archive|expected XML|expected LZFSE|a complete gzip|Failed to open|expected a COLMAP model"
)
"""Phrases of errors that are raised before the content of a file is reached."""


@dataclass
class Counts:
    """Outcomes of the files of a format.

    Attributes:
        read: files read without an error.
        header: files refused before their content was reached.
        behind: files refused for their content.
        slowest: maximum CPU seconds for a file.
        memory: maximum bytes of memory for a file, beyond ``EACH`` times those of its content as float32.
        faults: number of each faulty file, and what happened that must not.
    """

    read: int = 0
    header: int = 0
    behind: int = 0
    slowest: float = 0.0
    memory: int = 0
    faults: list[tuple[int, str]] = field(default_factory=list)

    @property
    def tried(self) -> int:
        """Number of files tried."""
        return self.read + self.header + self.behind + len(self.faults)

    def add(self, other: "Counts") -> None:
        """Add the outcomes of more files."""
        self.read, self.header = self.read + other.read, self.header + other.header
        self.behind, self.faults = self.behind + other.behind, self.faults + other.faults
        self.slowest, self.memory = max(self.slowest, other.slowest), max(self.memory, other.memory)


def content(kind: Format, seed: int, number: int) -> bytes:
    """Return a damaged file, which the seed and its number determine."""
    rng = random.Random(f"{seed} {number}")
    return kind.damage(rng.choice(kind.wholes), rng)


def try_files(kind: Format, count: int, seed: int, folder: Path, first: int = 0, at: mmap | None = None) -> Counts:
    """Read damaged files of a format in this process.

    Args:
        kind: the format.
        count: number of files.
        seed: seed of all files.
        folder: an empty folder to work in.
        first: number of the first file.
        at: shared memory that receives the number of each file before it is read.
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
    """Read one file and count the outcome."""
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
    """Return a memory figure of this process from Linux's /proc/self/status, in bytes."""
    status = Path("/proc/self/status").read_bytes()
    at = status.index(name.encode()) + len(name) + 1
    return 1024 * int(status[at : at + 20].split()[0])


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Suppress what readers print through Python."""
    with contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):
        yield


def held(value: Any) -> int:
    """Return the bytes that all numbers in a value would take as float32."""
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
    """Read damaged files of a format in subprocesses, which a file may crash.

    Args:
        name: name of the format.
        count: number of files.
        seed: seed of all files.
        folder: folder to work in.
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
        # the counts of earlier files are lost with the process, so try those again without this one
        if number > first:
            counts.add(try_apart(name, number - first, seed, folder, first))
        ended = signal.Signals(-status).name if status < 0 else f"exit status {status}"
        counts.faults.append((number, f"ended the process: {ended}"))
        first = number + 1
    return counts


def _plain(found: Mapping[str, Any]) -> dict[str, Any]:
    return {**found, "faults": [(number, text) for number, text in found["faults"]]}


def _tell(tell: int, name: str, count: int, seed: int, folder: Path, first: int, at: mmap) -> None:
    """Try files in this process, write their counts to a pipe, and exit."""
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
