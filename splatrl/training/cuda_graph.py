"""A function over tensors at fixed addresses, launched as one CUDA graph."""

from collections.abc import Callable, Sequence

import torch

WARM_UP = 3
"""Calls before the capture, during which libraries choose their kernels and allocate their memory."""


class CudaGraph:
    """Calls a function, captures it after a few calls, and from then on launches all its kernels at once.

    The function has no arguments and returns nothing: it reads and writes tensors in place on one CUDA device, never
    synchronises with the host, and takes the same path in every call. Its Python code runs only until it is captured.

    Args:
        function: the function to call.
        generators: the generators from which it draws, other than PyTorch's own.

    Raises:
        RuntimeError: in the call that captures, if the function cannot be captured.
    """

    def __init__(self, function: Callable[[], None], generators: Sequence[torch.Generator] = ()):
        self.function, self.generators = function, generators
        self.calls = 0
        self.graph: torch.cuda.CUDAGraph | None = None

    def __call__(self) -> None:
        """Run the function once."""
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
        with torch.cuda.stream(beside):  # as captures run on a side stream: one-off setup must happen there too
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
                "collector.cuda_graph: expected a step that never synchronises with the host, got one that could not "
                "be captured; type collector.cuda_graph=false to train without a graph"
            ) from error
        return graph
