"""Interrupts of a training, which ends once its batch has been learned from and saved."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def interrupts() -> Iterator[list[int]]:
    """Collect the interrupts of a block in a list; the second one raises ``KeyboardInterrupt`` at once.

    A termination (SIGTERM) is treated likewise, if it would have interrupted the block.
    """
    found: list[int] = []

    def note(number: int, frame: Any) -> None:
        if found:
            raise KeyboardInterrupt
        found.append(number)
        print("\nstopping after this batch; interrupt again to stop immediately", file=sys.stderr)

    if threading.current_thread() is not threading.main_thread():
        yield found  # only the main thread can handle signals
        return
    numbers = [signal.SIGINT]
    if signal.getsignal(signal.SIGTERM) is signal.default_int_handler:
        numbers.append(signal.SIGTERM)
    before = [signal.signal(number, note) for number in numbers]
    try:
        yield found
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
