"""Describes the GPU that is measured, measures its peak rates, and times calls on it."""

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
"""Macros of the kernel: independent sums per thread, and unrolled steps."""
THREADS = 256
MOST_ROUNDS = 9

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Machine:
    """A device and the best rates that it achieved.

    Attributes:
        name: name that its driver reports.
        architecture: for example sm_90; empty for a CPU.
        multiprocessors: number of multiprocessors.
        memory_bytes: size of its memory.
        driver: version of NVIDIA's kernel module.
        cuda: CUDA version with which PyTorch was built.
        torch: version of PyTorch.
        flops: float32 operations per second of a kernel of nothing but fused multiply-adds, which count as two each.
        memory_bandwidth: bytes per second, read and written, of a copy that fits into no cache.
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
        """The name for use in file names: h200 for ``NVIDIA H200``, rtx-4090 for ``NVIDIA GeForce RTX 4090``."""
        words = re.sub(r"[^a-z0-9]+", " ", self.name.lower()).split()
        return "-".join(word for word in words if word not in ("nvidia", "geforce", "graphics", "device")) or "gpu"

    def __str__(self) -> str:
        rates = f"{self.flops / 1e12:.2f} Tflop/s, {self.memory_bandwidth / 1e9:,.0f} GB/s"
        versions = f"driver {self.driver or 'unknown'}, CUDA {self.cuda or 'none'}, PyTorch {self.torch}"
        return f"{self.name} {self.architecture}, {self.memory_bytes / 2**30:.0f} GiB: {rates}; {versions}"


UNKNOWN = Machine("unknown GPU", "", 0, 0, "", torch.version.cuda or "", torch.__version__, math.nan, math.nan)
"""Stands for the device if it could not be measured."""


def measured_machine(device: torch.device, kernels: Kernels | None, copied: int) -> Machine:
    """Measure a device.

    Args:
        device: a GPU, or the CPU in a dry run.
        kernels: kernels of ``RATE``; None compiles them for the device.
        copied: size of the copy that measures bandwidth, bytes.
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
    """Return the operations per second of the kernel that only multiplies and adds."""
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
    """Return the version of NVIDIA's kernel module as Linux reports it; empty if there is none."""
    path = Path("/proc/driver/nvidia/version")
    found = re.search(r"\d+\.\d+(\.\d+)?", path.read_text()) if path.is_file() else None
    return found.group() if found else ""


def seconds(device: torch.device, call: Callable[[], object]) -> float:
    """Time what a call queues on a device, including gaps in which the device waits for the host."""
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
    """Measure the seconds of every call in each round; the calls take turns, after one or two to warm up.

    Args:
        calls: calls to compare.
        device: device on which they run.
        budget: seconds for all rounds together; there is at least one round.
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
    """A rate per second: its median over the rounds, and its extremes."""

    typical: float
    slowest: float
    fastest: float

    def __str__(self) -> str:
        return f"{self.typical:,.0f} ({self.slowest:,.0f} to {self.fastest:,.0f})"


def rate(count: int, times: list[float]) -> Rate:
    """Return the rate of a call that processes ``count`` items, by its seconds in each round."""
    return Rate(*(round(count / value, 1) for value in (median(times), max(times), min(times))))


@contextmanager
def peak_memory(device: torch.device) -> Iterator[list[int]]:
    """Yield a list that receives, after the block, PyTorch's peak memory during the block, bytes; 0 on a CPU."""
    found: list[int] = []
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    yield found
    found.append(torch.cuda.max_memory_allocated(device) if device.type == "cuda" else 0)
