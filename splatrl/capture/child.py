"""Run a stage in a subprocess that passes its progress on and never outlives the caller."""

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
    "map globally": re.compile(r"bundle adjustment iteration (\d+) / (\d+) finished"),
}
KEPT_LINES = 12
FULL = re.compile(r"disk is full|No space left", re.IGNORECASE)
"""Messages by which SQLite and the system report a full disk; COLMAP's crash report, which follows, would hide them."""


def run_child(module: str, folder: Path, progress: Progress) -> None:
    """Run a Python module in a subprocess until it ends; an exception here, Ctrl-C included, kills it.

    Args:
        module: name of the module.
        folder: the module's only argument.
        progress: called with what the subprocess prints: JSON lists of what, done and total, or COLMAP's own lines.

    Raises:
        CaptureError: where the subprocess fails, with its last lines.
        OSError: where it fails because the disk is full.
    """
    command = [sys.executable, "-m", module, str(folder)]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env={**os.environ, "OMP_NUM_THREADS": "1"},  # fixes the order of sums; COLMAP's own threads remain
        start_new_session=True,  # Ctrl-C reaches this process only, which then kills the child
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
        raise CaptureError(f"{module} failed with exit code {code}:\n" + "\n".join(last))


def _read(stream: IO[str], lines: "queue.Queue[str | None]") -> None:
    with contextlib.suppress(ValueError):  # the caller closed the stream
        for line in stream:
            lines.put(line)
    lines.put(None)


def _next(lines: "queue.Queue[str | None]") -> str | None:
    while True:  # some platforms cannot interrupt a wait without a timeout
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
