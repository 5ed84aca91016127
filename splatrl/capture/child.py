"""A stage in a process of its own: its progress is passed on, and it never outlives the caller."""

import contextlib
import errno
import json
import os
import queue
import re
import subprocess
import sys
import threading
from collections import deque
from pathlib import Path
from typing import IO

from splatrl.capture.base import CaptureError
from splatrl.capture.progress import Progress

COLMAP_TELLS = {
    "extract": re.compile(r"Processed file \[(\d+)/(\d+)\]"),
    "match": re.compile(r"block \[(\d+)/(\d+)"),
    "map at once": re.compile(r"bundle adjustment iteration (\d+) / (\d+) finished"),
}
KEPT_LINES = 12
FULL = re.compile(r"disk is full|No space left", re.IGNORECASE)
"""What SQLite and the system say; the lines of COLMAP's crash that follow hide it."""


def run_child(module: str, folder: Path, progress: Progress) -> None:
    """Run a module with a folder as its argument until it ends; an exception here, Ctrl-C included, kills it.

    Args:
        module: of Python.
        folder: its only argument.
        progress: told what the process prints: JSON lists of what, done and total, or COLMAP's own lines.

    Raises:
        CaptureError: where the process fails, with its last lines.
        OSError: where it fails for want of room on the disk.
    """
    command = [sys.executable, "-m", module, str(folder)]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env={**os.environ, "OMP_NUM_THREADS": "1"},  # sums in one order; COLMAP's own threads remain
        start_new_session=True,  # Ctrl-C reaches this process only, which then kills the other
    )
    assert process.stdout is not None and process.stdin is not None
    lines: queue.Queue[str | None] = queue.Queue()
    reader = threading.Thread(target=_read, args=(process.stdout, lines), daemon=True)
    reader.start()
    last: deque[str] = deque(maxlen=KEPT_LINES)
    full = False
    try:
        while (line := _next(lines)) is not None:
            if not _pass_on(line, progress):
                last.append(line.rstrip())
                full |= bool(FULL.search(line))
        code = process.wait()
    finally:
        process.kill()
        process.wait()
        process.stdin.close()
        reader.join(1)
        process.stdout.close()
    if code and full:
        raise OSError(errno.ENOSPC, f"cannot write: {os.strerror(errno.ENOSPC)}", str(folder))
    if code:
        raise CaptureError(f"{module} failed with code {code}:\n" + "\n".join(last))


def _read(stream: IO[str], lines: "queue.Queue[str | None]") -> None:
    with contextlib.suppress(ValueError):  # closed by the caller
        for line in stream:
            lines.put(line)
    lines.put(None)


def _next(lines: "queue.Queue[str | None]") -> str | None:
    while True:  # a wait without an end could not be interrupted everywhere
        with contextlib.suppress(queue.Empty):
            return lines.get(timeout=0.1)


def _pass_on(line: str, progress: Progress) -> bool:
    if line.startswith("["):
        with contextlib.suppress(ValueError):
            what, done, total = json.loads(line)
            progress(what, done, total)
            return True
    for what, told in COLMAP_TELLS.items():
        if found := told.search(line):
            progress(what, int(found[1]), int(found[2]))
            return True
    return False
