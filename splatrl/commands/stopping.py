"""Ends a long command that is interrupted by Ctrl-C, or terminated as by a cluster, with its finished work kept."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

INTERRUPTED = 130
"""Exit code of a command interrupted by Ctrl-C."""


class Terminated(BaseException):
    """SIGTERM ends the command."""


def terminate(number: int, frame: object) -> NoReturn:
    """Raise ``Terminated``; the same signal once more ends the process at once."""
    signal.signal(number, signal.SIG_DFL)
    raise Terminated


@contextmanager
def tidy() -> Iterator[None]:
    """Let SIGTERM end the block like an exception, so that no temporary files stay, and then the process as ever."""
    try:
        with handled(terminate, *_unhandled(signal.SIGTERM)):
            yield
    except Terminated:
        signal.raise_signal(signal.SIGTERM)


@contextmanager
def stoppable(how_to_continue: str) -> Iterator[None]:
    """Turn an interrupt of the block, or a SIGTERM, into one line and the exit code of interrupted commands.

    SIGTERM counts as an interrupt, unless somebody else handles it, as launchers for clusters do.

    Args:
        how_to_continue: the end of the line, such as ``"run the same command again to continue"``.

    Raises:
        SystemExit: after an interrupt.
    """
    try:
        with interrupted_by(signal.SIGTERM):
            yield
    except KeyboardInterrupt:
        print(f"\nstopped; finished work is kept; {how_to_continue}", file=sys.stderr)
        sys.exit(INTERRUPTED)


@contextmanager
def interrupted_by(*numbers: signal.Signals) -> Iterator[None]:
    """Let signals that would end the program raise KeyboardInterrupt in the block, unless somebody handles them.

    Args:
        numbers: such as SIGTERM, or SIGHUP, which a terminal sends when it is closed or its connection is lost.
    """
    with handled(signal.default_int_handler, *_unhandled(*numbers)):
        yield


def _unhandled(*numbers: signal.Signals) -> list[signal.Signals]:
    """Return those of the signals that nobody but ``tidy`` handles."""
    return [one for one in numbers if signal.getsignal(one) in (signal.SIG_DFL, terminate)]


@contextmanager
def handled(handler: Callable[..., Any] | signal.Handlers, *numbers: signal.Signals) -> Iterator[None]:
    """Let a handler answer signals in the block; ``signal.SIG_IGN`` ignores them."""
    alone = threading.current_thread() is threading.main_thread()  # no other thread can handle signals
    before = {number: signal.signal(number, handler) for number in numbers if alone}
    try:
        yield
    finally:
        for number, usual in before.items():
            signal.signal(number, signal.SIG_DFL if usual is None else usual)  # None: it was not set from Python
