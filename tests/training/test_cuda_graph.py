"""Warm-up, capture and replay of a function, with a fake CUDA."""

from contextlib import contextmanager, nullcontext

import pytest
import torch

from splatrl.training.cuda_graph import WARM_UP, CudaGraph
from tests.training.tape import Tape


class PretendedGraph:
    """A CUDA graph that records on a tape."""

    def __init__(self) -> None:
        self.tape, self.generators = Tape(), []

    def register_generator_state(self, generator: torch.Generator) -> None:
        self.generators.append(generator)

    def replay(self) -> None:
        self.tape.replay()


class PretendedStream:
    """A stream that never waits."""

    def wait_stream(self, stream: "PretendedStream") -> None:
        pass


@pytest.fixture(autouse=True)
def pretended_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def capture(graph: PretendedGraph) -> object:
        before = total.clone()
        with graph.tape:
            yield
        total.copy_(before)  # a capture does not execute anything

    monkeypatch.setattr(torch.cuda, "CUDAGraph", PretendedGraph)
    monkeypatch.setattr(torch.cuda, "Stream", PretendedStream)
    monkeypatch.setattr(torch.cuda, "current_stream", PretendedStream)
    monkeypatch.setattr(torch.cuda, "stream", lambda stream: nullcontext())
    monkeypatch.setattr(torch.cuda, "graph", capture)


total = torch.zeros(1)


def test_each_call_does_the_work_once_and_python_runs_until_the_capture() -> None:
    total.zero_()
    ran = []

    def work() -> None:
        ran.append(len(ran))
        total.add_(1)

    generator = torch.Generator()
    call = CudaGraph(work, [generator])
    for count in range(1, 9):
        call()
        assert total.item() == count
    assert len(ran) == WARM_UP + 1
    assert call.graph is not None and call.graph.generators == [generator]


def test_a_failed_capture_says_how_to_train_without_a_graph() -> None:
    def work() -> None:
        if len(ran) == WARM_UP:
            raise RuntimeError("operation not permitted when stream is capturing")
        ran.append(0)

    ran: list[int] = []
    call = CudaGraph(work)
    for _ in range(WARM_UP):
        call()
    with pytest.raises(RuntimeError, match=r"could not be captured; type collector\.cuda_graph=false to train without"):
        call()
