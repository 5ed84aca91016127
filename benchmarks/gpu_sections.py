"""Runs a section of a benchmark in its own process, which ends in time even if the section crashes or hangs."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

LAST_LINES = 40
"""Number of lines of a section's output that are kept."""
GRACE = 5.0
"""Seconds to wait for a killed process to disappear; one that waits for a broken driver may never do so."""


@dataclass(frozen=True)
class Section:
    """The end of a section: done, failed (a Python exception), ended by a signal, or killed because its time was over.

    Attributes:
        name: name of the section.
        ending: how it ended, in words.
        seconds: time from its start to its end.
    """

    what = "section"
    name: str
    ending: str
    seconds: float

    @property
    def done(self) -> bool:
        """Whether the section completed."""
        return self.ending == "done"


def run_section(name: str, command: Sequence[str], seconds: float) -> tuple[Section, str]:
    """Run a command until it ends or its time is over, then kill whatever it has started.

    Args:
        name: name of the section.
        command: command to run; its output is printed as it comes.
        seconds: time after which it is killed.

    Returns:
        The section, and the last lines of its output.
    """
    begun, last = time.monotonic(), deque[str](maxlen=LAST_LINES)
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        start_new_session=True,  # its own process group, which can be killed as a whole
    )
    reader = threading.Thread(target=_pass_on, args=(process.stdout, last), daemon=True)
    reader.start()
    try:
        ending = _ending(process.wait(max(0.0, seconds)))
    except subprocess.TimeoutExpired:
        ending = f"killed after {time.monotonic() - begun:.0f} s"
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        with suppress(subprocess.TimeoutExpired):
            process.wait(GRACE)
        reader.join(GRACE)
    return Section(name, ending, round(time.monotonic() - begun, 1)), "".join(last)


def _ending(status: int) -> str:
    """Describe the end of a process by its exit status."""
    if status == 0:
        return "done"
    return "failed" if status > 0 else f"ended by {signal.Signals(-status).name}"


def _pass_on(stream: IO[str], last: deque[str]) -> None:
    """Print lines as they come, and keep the last ones."""
    for line in stream:
        sys.stdout.write(line)
        sys.stdout.flush()
        last.append(line)
