"""Kernels are loaded and launched through the driver: here a fake one, whose kernels the emulator runs."""

import ctypes
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from enum import IntEnum
from types import SimpleNamespace

import pytest
import torch

from splatrl.native.cuda import kernels
from splatrl.native.cuda.kernels import FREELY_SHARED, CudaKernels
from splatrl.renderers import CudaRenderer
from splatrl.renderers.cuda import kernel_defines
from tests.emulator import emulated
from tests.renderers.cases import random_cameras, random_gaussians

pytest.importorskip("cuda.bindings", reason="needs the extra cuda")


class Attribute(IntEnum):
    """The only function attribute that is set."""

    CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES = 8


PRIMARY, INVALID_CONTEXT = 11, 201


class Context(threading.local):
    """The CUDA context that is current in a thread; a new thread has none."""

    number = 0


class PretendedDriver:
    """A fake driver that records what it is asked to do, with arguments of the types that the real one takes.

    Like the real one, it refuses to work in a thread where the device's context is not current.
    """

    CUfunction_attribute = Attribute
    CUstream = staticmethod(int)

    def __init__(self, source: str, defines: dict[str, int]) -> None:
        self.emulated = emulated(source, defines)
        self.images: list[bytes] = []
        self.allowed: dict[str, int] = {}
        self.launched: list[tuple[str, int, int, int, int]] = []
        self.error = 0
        self.context = Context()

    @property
    def status(self) -> int:
        """Status code of a call that needs a context."""
        return self.error if self.context.number == PRIMARY else INVALID_CONTEXT

    def cuDeviceGet(self, ordinal: int | None) -> tuple[int, str]:
        return self.error, "device"

    def cuDevicePrimaryCtxRetain(self, device: str) -> tuple[int, int]:
        assert device == "device"
        return self.error, PRIMARY

    def cuCtxGetCurrent(self) -> tuple[int, int]:
        return self.error, self.context.number

    def cuCtxSetCurrent(self, context: int) -> tuple[int]:
        self.context.number = context
        return (self.error,)

    def cuModuleLoadData(self, image: int) -> tuple[int, str]:
        self.images.append(ctypes.string_at(image, 4))
        return self.status, "module"

    def cuModuleGetFunction(self, module: str, name: bytes) -> tuple[int, str]:
        assert module == "module"
        return self.status, name.decode()

    def cuFuncSetAttribute(self, kernel: str, attribute: Attribute, value: int) -> tuple[int]:
        self.allowed[kernel] = value
        return (self.status,)

    def cuOccupancyMaxActiveBlocksPerMultiprocessor(self, kernel: str, threads: int, shared: int) -> tuple[int, int]:
        return self.status, 3

    def cuLaunchKernel(self, kernel: str, *shape: int) -> tuple[int]:
        x, y, z, threads, threads_y, threads_z, shared, stream, arguments, extra = shape
        assert (y, z, threads_y, threads_z, extra) == (1, 1, 1, 1, 0)
        self.launched.append((kernel, x, threads, shared, stream))
        assert self.emulated._library.launch(kernel.encode(), x, threads, arguments, 0)
        return (self.status,)


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> list[PretendedDriver]:
    """A fake GPU: the fake driver of each kernel source that is loaded, in order."""
    drivers: list[PretendedDriver] = []

    def pretend(source: str, arch: str, defines: dict[str, int]) -> bytes:
        import cuda.bindings

        assert arch == "sm_90"
        drivers.append(PretendedDriver(source, defines))
        monkeypatch.setattr(cuda.bindings, "driver", drivers[-1], raising=False)
        return b"\x7fELF and more"

    monkeypatch.setattr(kernels, "compiled", pretend)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: (9, 0))
    properties = SimpleNamespace(multi_processor_count=2, total_memory=2**30)
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device: properties)
    monkeypatch.setattr(torch.cuda, "device", lambda device: nullcontext())
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: SimpleNamespace(cuda_stream=77))
    return drivers


def test_a_renderer_loads_and_launches_its_kernels_through_the_driver(driver: list[PretendedDriver]) -> None:
    scene, cameras = random_gaussians(3, 300, 1), random_cameras(4, 3, 70, 40)
    renderer = CudaRenderer(scene, tolerance=0.5, device="cpu")
    pixels = renderer.pixels(cameras)
    assert torch.equal(pixels, CudaRenderer(scene, tolerance=0.5, load=emulated).pixels(cameras))
    one = driver[0]
    name, blocks, threads, shared, stream = one.launched[0]
    assert one.images == [b"\x7fELF"] and one.allowed == {"draw_pixels": shared}
    assert (name, threads, stream) == ("draw_pixels", 256, 77)
    assert blocks == 6 and shared > FREELY_SHARED  # three on each of two multiprocessors, for 18 tiles
    assert one.launched[1:] == []


def test_any_thread_can_load_and_launch_kernels(driver: list[PretendedDriver]) -> None:
    scene, cameras = random_gaussians(3, 30), random_cameras(4, 2, 20, 30)
    with ThreadPoolExecutor(1) as first, ThreadPoolExecutor(1) as second:
        renderer = first.submit(CudaRenderer, scene, device="cpu").result()
        pixels = second.submit(renderer.pixels, cameras).result()  # asks how many blocks are resident, and launches
        again = first.submit(renderer.pixels, cameras).result()
    assert torch.equal(pixels, again) and torch.equal(pixels, renderer.pixels(cameras))


def test_a_kernel_is_allowed_the_shared_memory_that_it_needs(driver: list[PretendedDriver]) -> None:
    loaded = CudaKernels("render", "cpu", kernel_defines(True, 0, False))
    assert loaded.resident("draw_images", 256, FREELY_SHARED + 1) == 3
    assert driver[0].allowed == {"draw_images": FREELY_SHARED + 1}


def test_an_error_of_the_driver_is_raised(driver: list[PretendedDriver]) -> None:
    loaded = CudaKernels("render", "cpu", kernel_defines(True, 0, False))
    driver[0].error = 700
    with pytest.raises(RuntimeError, match="CUDA driver on cpu: 700"):
        loaded.resident("draw_pixels", 256)
