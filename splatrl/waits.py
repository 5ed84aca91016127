"""What people are told while something takes long."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

LONG = 3.0
"""Seconds after which people are told what they are waiting for."""


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


def late_bar(what: str, total: int | None, unit: str) -> tqdm:
    """Return a progress bar that appears only on a terminal, and if something takes long, and disappears at its end.

    It may stand below another bar, which takes codes that move the cursor and that a log would keep.
    """
    return _LateBar(desc=what, total=total, unit=unit, leave=False, delay=LONG, disable=None, dynamic_ncols=True)


class _LateBar(tqdm):
    """A bar that keeps to its delay where lines are written above it, for which tqdm would draw it at once."""

    last_print_t: float

    def display(self, msg: str | None = None, pos: int | None = None) -> Any:
        appears = self.start_t + self.delay
        if self._time() < appears:
            return False
        self.last_print_t = max(self.last_print_t, appears)  # only what was shown is cleared in the end
        return super().display(msg, pos)
