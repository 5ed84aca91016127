"""The GPU that is measured: what it is, how fast it can be, and how long things take on it."""

import math
import re
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TypeVar

import torch

from splatrl.native.cuda.kernels import CudaKernels, Kernels

RATE = Path(__file__).with_name("gpu_rate.cu")
CHAINS, STEPS = 8, 16
"""Of the kernel: independent sums per thread, and steps that are unrolled."""
THREADS = 256
MOST_ROUNDS = 9

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Machine:
    """A device, and the best that it achieved.

    Attributes:
        name: as its driver reports it.
        architecture: sm_90 and so on; empty for a CPU.
        multiprocessors: how many it has.
        memory_bytes: how much memory it has.
        driver: version of the kernel module.
        cuda: version that PyTorch was built with.
        torch: version.
        flops: float32 operations per second of nothing but fused multiply-adds, each of which is two.
        memory_bandwidth: bytes per second, read and written, of a copy that no cache holds.
    """

    name: str
    architecture: str
    multiprocessors: int
    memory_bytes: int
    driver: str
    cuda: str
    torch: str
    flops: float
    memory_bandwidth: float

    @property
    def slug(self) -> str:
        """The name for files: h200 for ``NVIDIA H200``, rtx-4090 for ``NVIDIA GeForce RTX 4090``."""
        words = re.sub(r"[^a-z0-9]+", " ", self.name.lower()).split()
        return "-".join(word for word in words if word not in ("nvidia", "geforce", "graphics", "device")) or "gpu"

    def __str__(self) -> str:
        rates = f"{self.flops / 1e12:.2f} Tflop/s, {self.memory_bandwidth / 1e9:,.0f} GB/s"
        versions = f"driver {self.driver or 'unknown'}, CUDA {self.cuda or 'none'}, PyTorch {self.torch}"
        return f"{self.name} {self.architecture}, {self.memory_bytes / 2**30:.0f} GiB: {rates}; {versions}"


UNKNOWN = Machine("unknown GPU", "", 0, 0, "", torch.version.cuda or "", torch.__version__, math.nan, math.nan)
"""The device, where it could not be measured."""


def measured_machine(device: torch.device, kernels: Kernels | None, copied: int) -> Machine:
    """Measure a device.

    Args:
        device: a GPU, or the CPU in a dry run.
        kernels: of ``RATE``, compiled for the device if not given.
        copied: bytes of a copy.
    """
    on_gpu = device.type == "cuda"
    kernels = kernels or CudaKernels(RATE, device, {"CHAINS": CHAINS, "STEPS": STEPS})
    properties = torch.cuda.get_device_properties(device) if on_gpu else None
    return Machine(
        name=properties.name if properties else "CPU",
        architecture=f"sm_{properties.major}{properties.minor}" if properties else "",
        multiprocessors=kernels.multiprocessors,
        memory_bytes=properties.total_memory if properties else 0,
        driver=_driver(),
        cuda=torch.version.cuda or "",
        torch=torch.__version__,
        flops=_multiply_adds(kernels, device),
        memory_bandwidth=_copy_bandwidth(device, copied),
    )


def _multiply_adds(kernels: Kernels, device: torch.device) -> float:
    """Operations per second of the kernel that does nothing but multiply and add."""
    on_gpu = device.type == "cuda"
    blocks, rounds = (32 * kernels.multiprocessors, 4096) if on_gpu else (1, 4)
    out = torch.empty(blocks * THREADS, device=device)

    def launch() -> None:
        kernels.launch("multiply_add", blocks, THREADS, out, rounds, 0.5, 1.0)

    fastest = min([seconds(device, launch) for _ in range(6)][1:])
    assert bool((out == 2.0 * CHAINS).all()), out  # the fixed point of x → x / 2 + 1
    return 2 * CHAINS * STEPS * rounds * blocks * THREADS / fastest


def _copy_bandwidth(device: torch.device, size: int) -> float:
    source = torch.zeros(size, dtype=torch.uint8, device=device)
    target = torch.empty_like(source)
    return 2 * size / min([seconds(device, lambda: target.copy_(source)) for _ in range(12)][1:])


def _driver() -> str:
    """Version of NVIDIA's kernel module, as Linux reports it; empty where there is none."""
    path = Path("/proc/driver/nvidia/version")
    found = re.search(r"\d+\.\d+(\.\d+)?", path.read_text()) if path.is_file() else None
    return found.group() if found else ""


def seconds(device: torch.device, call: Callable[[], object]) -> float:
    """How long a device is busy with what a call queues, including gaps in which it waits for the host."""
    if device.type != "cuda":
        start = time.perf_counter()
        call()
        return time.perf_counter() - start
    begun, done = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    with torch.cuda.device(device):
        begun.record()
        call()
        done.record()
        done.synchronize()
    return begun.elapsed_time(done) / 1e3


def in_turns(calls: Mapping[Key, Callable[[], object]], device: torch.device, budget: float) -> dict[Key, list[float]]:
    """Seconds of every call in each round; all take turns, after one or two calls to warm up.

    Args:
        calls: those that are compared.
        device: the one that they run on.
        budget: seconds that the rounds may take together; there is at least one round.
    """
    once = sum(seconds(device, call) for call in calls.values())
    if once < budget:  # the first call is slower than later ones
        once = sum(seconds(device, call) for call in calls.values())
    rounds = max(1, min(MOST_ROUNDS, int(budget / max(once, 1e-9))))
    found: dict[Key, list[float]] = {key: [] for key in calls}
    for _ in range(rounds):
        for key, call in calls.items():
            found[key].append(seconds(device, call))
    return found


@dataclass(frozen=True)
class Rate:
    """A rate per second: the median over the rounds, and the extremes."""

    typical: float
    slowest: float
    fastest: float

    def __str__(self) -> str:
        return f"{self.typical:,.0f} ({self.slowest:,.0f} to {self.fastest:,.0f})"


def rate(count: int, times: list[float]) -> Rate:
    """The rate of ``count`` things in each of these times."""
    return Rate(*(round(count / value, 1) for value in (median(times), max(times), min(times))))


@contextmanager
def peak_memory(device: torch.device) -> Iterator[list[int]]:
    """A list that holds, after the block, PyTorch's peak memory in it, bytes; 0 on a CPU."""
    found: list[int] = []
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    yield found
    found.append(torch.cuda.max_memory_allocated(device) if device.type == "cuda" else 0)
