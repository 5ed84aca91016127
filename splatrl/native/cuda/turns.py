"""Serialises launches that share working memory, whatever streams they are on."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch


class Turns:
    """Makes each launch wait for earlier ones that were on other streams.

    Launches on the same stream follow one another anyway, so nothing is queued for them. A launch that is captured in a
    CUDA graph takes no turn: whoever replays the graph on a different stream must order it themselves.

    Args:
        device: the device that holds the memory; turns have no effect on any other than a CUDA device.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self._lock = threading.Lock()
        self._last: torch.cuda.Stream | None = None

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Take a turn on PyTorch's current stream; the ``with`` block queues its launches there."""
        if self.device.type != "cuda":
            yield
            return
        stream = torch.cuda.current_stream(self.device)
        with self._lock:  # another thread cannot wait for work that is not queued yet
            if self._last is None or stream.cuda_stream != self._last.cuda_stream:
                self._change(stream)
            yield

    def _change(self, stream: torch.cuda.Stream) -> None:
        with torch.cuda.device(self.device):
            if torch.cuda.is_current_stream_capturing():
                return
            if self._last is not None:
                stream.wait_stream(self._last)
            self._last = stream
