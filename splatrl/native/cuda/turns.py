"""Launches that share working memory, one after the other whatever streams they are on."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch


class Turns:
    """Makes a launch wait for those before it that were on other streams.

    On one stream, where launches follow one another anyway, nothing is queued. A launch that is captured in a CUDA
    graph takes no turn: whoever replays the graph on another stream than the others must order it.

    Args:
        device: where the memory is; nothing is done but on a CUDA device.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self._lock = threading.Lock()
        self._last: torch.cuda.Stream | None = None

    @contextmanager
    def taken(self) -> Iterator[None]:
        """A turn on PyTorch's current stream, in which the block queues its launches."""
        if self.device.type != "cuda":
            yield
            return
        stream = torch.cuda.current_stream(self.device)
        with self._lock:  # until it is queued, another thread cannot wait for it
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
