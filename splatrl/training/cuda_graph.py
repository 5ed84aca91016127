"""A function of tensors that stay where they are, launched as one CUDA graph."""

from collections.abc import Callable, Sequence

import torch

WARM_UP = 3
"""Calls before the capture, in which libraries choose their kernels and take their memory."""


class CudaGraph:
    """Calls a function; after a few calls it is captured, and from then on its kernels are launched all at once.

    The function has no arguments and returns nothing: it reads and writes tensors in place, on one CUDA device, asks
    the host nothing, and goes the same way each time. What it does in Python happens only until it is captured.

    Args:
        function: what to call.
        generators: those from which it draws, but for PyTorch's own.

    Raises:
        RuntimeError: at the call that captures, where the function cannot be.
    """

    def __init__(self, function: Callable[[], None], generators: Sequence[torch.Generator] = ()):
        self.function, self.generators = function, generators
        self.calls = 0
        self.graph: torch.cuda.CUDAGraph | None = None

    def __call__(self) -> None:
        """Do once what the function does."""
        if self.graph is None and self.calls < WARM_UP:
            self._warm_up()
            self.calls += 1
            return
        if self.graph is None:
            self.graph = self._capture()
        self.graph.replay()

    def _warm_up(self) -> None:
        beside = torch.cuda.Stream()
        beside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(beside):  # as captures are, so that what is set up once is set up for them
            self.function()
        torch.cuda.current_stream().wait_stream(beside)

    def _capture(self) -> torch.cuda.CUDAGraph:
        graph = torch.cuda.CUDAGraph()
        for generator in self.generators:
            graph.register_generator_state(generator)
        try:
            with torch.cuda.graph(graph):
                self.function()
        except RuntimeError as error:
            raise RuntimeError(
                "collector.cuda_graph: expected a step that asks the host nothing, and could not capture it; "
                "collector.cuda_graph=false goes without"
            ) from error
        return graph
