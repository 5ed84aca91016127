"""Standard output and error of the commands, which outlive readers that leave and know encodings that lack signs."""

import codecs
import io
import os
import stat
import sys
from typing import Any


def open_outputs() -> None:
    """Prepare both: no letter fails to be written, and a pipe whose reader leaves, such as ``head``, ends no command.

    What such a reader no longer reads is dropped, and the command goes on: it writes files, too.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper):
            continue
        if codecs.lookup(stream.encoding).name != "utf-8":
            stream.reconfigure(errors="replace")  # pages and messages hold signs that not every encoding has
        if isinstance(getattr(stream.buffer, "raw", stream.buffer), io.FileIO) and _is_pipe(stream.fileno()):
            setattr(sys, name, _forgiving(stream))


def _is_pipe(number: int) -> bool:
    mode = os.fstat(number).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


def _forgiving(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    stream.flush()
    pipe = _Pipe(stream.fileno(), "w", closefd=False)
    return io.TextIOWrapper(
        pipe if isinstance(stream.buffer, io.FileIO) else io.BufferedWriter(pipe),  # unbuffered, as Python may be asked
        stream.encoding,
        stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


class _Pipe(io.FileIO):
    """A pipe that becomes the null device when its reader leaves, as Python's documentation on SIGPIPE advises."""

    def write(self, data: Any, /) -> int:
        """Write bytes, and return how many were written."""
        try:
            return super().write(data)
        except (BrokenPipeError, ConnectionResetError):  # a socket's reader may leave in either way
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            return super().write(data)
