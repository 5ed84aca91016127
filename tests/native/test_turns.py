"""Launches that share memory wait for each other across CUDA streams; most of the streams here are fakes."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, TimeoutError
from contextlib import contextmanager, nullcontext

import pytest
import torch

from splatrl.cameras import Cameras
from splatrl.native.cuda.turns import Turns
from splatrl.renderers import CudaRenderer
from splatrl.renderers import cuda as renderers
from tests.emulator import emulated
from tests.renderers.cases import random_cameras, random_gaussians


class Stream:
    """A fake stream that records which other streams it was made to wait for."""

    def __init__(self) -> None:
        self.waited: list[Stream] = []
        self.cuda_stream = id(self)

    def wait_stream(self, other: "Stream") -> None:
        self.waited.append(other)


class Streams(threading.local):
    """The current stream of a thread, and whether it is being captured."""

    now: Stream
    captured = False


@pytest.fixture
def streams(monkeypatch: pytest.MonkeyPatch) -> Streams:
    """The streams of a fake GPU."""
    found = Streams()
    monkeypatch.setattr(torch.cuda, "device", lambda device: nullcontext())
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: found.now)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: found.captured)
    return found


def on(streams: Streams, stream: Stream, turns: Turns, captured: bool = False) -> None:
    """Take a turn on a stream."""
    streams.now, streams.captured = stream, captured
    with turns.taken():
        pass


def test_a_launch_waits_for_earlier_launches_on_another_stream(streams: Streams) -> None:
    one, two, turns = Stream(), Stream(), Turns(torch.device("cuda", 0))
    for stream in (one, one, two, two, one):
        on(streams, stream, turns)
    assert one.waited == [two] and two.waited == [one]


def test_a_captured_launch_neither_waits_nor_is_waited_for(streams: Streams) -> None:
    one, two, turns = Stream(), Stream(), Turns(torch.device("cuda", 0))
    on(streams, one, turns)
    on(streams, two, turns, captured=True)
    on(streams, one, turns)
    assert one.waited == two.waited == []


def test_a_thread_waits_until_the_launch_of_another_is_queued(streams: Streams) -> None:
    one, two, turns = Stream(), Stream(), Turns(torch.device("cuda", 0))
    streams.now, streams.captured = one, False
    with ThreadPoolExecutor(1) as other:
        with turns.taken():
            turn = other.submit(on, streams, two, turns)
            with pytest.raises(TimeoutError):
                turn.result(0.05)
        turn.result()
    assert two.waited == [one]


def test_turns_on_a_cpu_use_no_streams(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(torch.cuda, "current_stream")
    with Turns(torch.device("cpu")).taken():
        pass


def test_a_renderer_launches_its_kernel_within_a_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    class Watched(Turns):
        @contextmanager
        def taken(self) -> Iterator[None]:
            said.append("turn")
            yield
            said.append("over")

    def load(source: str, defines: dict[str, int]) -> object:
        loaded = emulated(source, defines)
        launch = loaded.launch
        monkeypatch.setattr(
            loaded, "launch", lambda name, *rest, **more: (said.append(name), launch(name, *rest, **more))
        )
        return loaded

    monkeypatch.setattr(renderers, "Turns", Watched)
    CudaRenderer(random_gaussians(3, 30), load=load).pixels(random_cameras(4, 2, 20, 30))
    assert said == ["turn", "draw_pixels", "over"]


@pytest.mark.gpu
def test_frames_drawn_on_two_streams_equal_those_drawn_on_one(cuda_device: torch.device) -> None:
    cameras = random_cameras(4, 256, 64, 64)
    cameras = Cameras(cameras.camera_to_world.to(cuda_device), cameras.K.to(cuda_device), 64, 64)
    renderer = CudaRenderer(random_gaussians(3, 5000, 1), device=cuda_device)
    expected, drawn = renderer.pixels(cameras), []
    torch.cuda.synchronize()
    for stream in 4 * [torch.cuda.Stream(), torch.cuda.Stream()]:
        with torch.cuda.stream(stream):
            drawn.append(renderer.pixels(cameras))
    torch.cuda.synchronize()
    assert all(torch.equal(pixels, expected) for pixels in drawn)
