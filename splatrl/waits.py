"""What people are told while something takes long."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

LONG = 3.0
"""Seconds after which people are told what they are waiting for."""


@contextmanager
def announced(what: str) -> Iterator[None]:
    """Print a line to stderr if the block, whose progress is not known, takes long.

    Args:
        what: what the block does, such as ``computing levels``.
    """
    timer = threading.Timer(LONG, lambda: print(what, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def late_bar(what: str, total: int, unit: str) -> tqdm:
    """Return a progress bar that appears only if something takes long, and that disappears at its end."""
    return tqdm(desc=what, total=total, unit=unit, leave=False, delay=LONG, dynamic_ncols=True)
