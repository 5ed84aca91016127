"""What people are told while something takes long."""

import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

LONG = 3.0
"""Seconds after which people are told what they are waiting for."""
SELDOM = 10.0
"""Seconds between the lines of a bar where it is not drawn in place, as in a log file."""


@contextmanager
def announced(what: str) -> Iterator[None]:
    """Print a line to stderr, above any bars, if the block, whose progress is not known, takes long.

    Args:
        what: what the block does, such as ``computing levels``.
    """
    timer = threading.Timer(LONG, lambda: tqdm.write(what, sys.stderr))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def late_bar(what: str, total: int | None, unit: str, counted: Iterable[Any] | None = None) -> "Bar":
    """Return a progress bar that appears only if something takes long, and disappears at its end.

    Args:
        what: what takes long, as a noun.
        total: number of units until the end; None if that is not known.
        unit: what is counted.
        counted: what iterating over the bar returns, each element counting as one unit; None to call ``update``.
    """
    return Bar(counted, desc=what, total=total, unit=unit, leave=False, delay=LONG)


class Bar(tqdm):
    """A progress bar with the time left; where lines stay, as in a log, it is a line every ``SELDOM`` seconds.

    A log would keep each state of a bar that is drawn in place, and the codes that move the cursor below another bar.
    """

    last_print_t: float
    leave: bool

    def __init__(self, *args: Any, **options: Any):
        self.lines = not (sys.stderr.isatty() or "ipykernel" in sys.modules)  # notebooks draw in place, too
        self._told = time.monotonic()
        super().__init__(*args, dynamic_ncols=True, **options)

    def display(self, msg: str | None = None, pos: int | None = None) -> Any:
        """Draw the bar, or print its line if it is time; at the end tqdm calls this once more, as disabled."""
        if self.lines:
            if msg is None and (self.disable or time.monotonic() - self._told >= SELDOM):
                self._told = time.monotonic()
                self.fp.write(f"{self}" if self.disable else f"{self}\n")  # tqdm ends the last line itself
            return False
        if self.delay:  # which tqdm forgets where lines are written above the bar
            appears = self.start_t + self.delay
            if self._time() < appears:
                return False
            self.last_print_t = max(self.last_print_t, appears)  # only what was shown is cleared in the end
        return super().display(msg, pos)

    def clear(self, *args: Any, **options: Any) -> None:
        """Clear the bar for lines above it; lines in a log stay."""
        if not self.lines:
            super().clear(*args, **options)

    def close(self) -> None:
        """End the bar; one that never moved, as before an error, is not left."""
        if not self.disable:
            self.leave = self.leave and self.n > self.initial
        super().close()
