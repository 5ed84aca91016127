"""Peak rates of one core of this machine, measured without the renderer."""

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

from splatrl.native import _core

MEBIBYTE = 2**20
LARGE, SMALL = 256 * MEBIBYTE, 4 * MEBIBYTE
"""Bytes of a tensor that fits into no cache, and of one that fits into the last-level cache."""
REPEATS = 12


@dataclass(frozen=True)
class Machine:
    """A processor, and the best rates that one of its cores achieved.

    Attributes:
        processor: name of the processor.
        cores: number of cores that this process may use.
        isa: instruction set that the renderer uses.
        flops: float32 operations per second of a matrix product; a fused multiply-add counts as two.
        memory_bandwidth: bytes per second, read and written, of a copy in main memory.
        cache_bandwidth: the same in the last-level cache.
        cache_bytes: size of the last-level cache; 0 if unknown.
    """

    processor: str
    cores: int
    isa: str
    flops: float
    memory_bandwidth: float
    cache_bandwidth: float
    cache_bytes: int

    def __str__(self) -> str:
        rates = f"{self.flops / 1e9:.0f} Gflop/s, {self.memory_bandwidth / 1e9:.0f} GB/s in memory"
        cache = f"{self.cache_bandwidth / 1e9:.0f} GB/s in cache ({self.cache_bytes / MEBIBYTE:.0f} MiB)"
        return f"{self.processor}, {self.cores} cores, {self.isa}; one core: {rates}, {cache}"


def measured_machine() -> Machine:
    """Measure this machine, which takes about two seconds; sets PyTorch to one thread."""
    torch.set_num_threads(1)
    size = 1024
    a, b, product = torch.randn(size, size), torch.randn(size, size), torch.empty(size, size)
    return Machine(
        processor=_processor(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        isa=_core.isa(),
        flops=2 * size**3 / _fastest(lambda: torch.mm(a, b, out=product)),
        memory_bandwidth=_copy_bandwidth(LARGE),
        cache_bandwidth=_copy_bandwidth(SMALL),
        cache_bytes=_cache_bytes(),
    )


def _copy_bandwidth(size: int) -> float:
    source = torch.zeros(size, dtype=torch.uint8)
    target = torch.empty_like(source)
    return 2 * size / _fastest(lambda: target.copy_(source))


def _fastest(call: Callable[[], object]) -> float:
    """Return the seconds of the fastest of a few calls, since a bound is what the machine can do, not its average."""
    call()
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def _processor() -> str:
    """Return the name that the processor reports."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if "model name" in line]
        if names:
            return names[0]
    return platform.processor() or platform.machine()


def _cache_bytes() -> int:
    """Return the size of the last-level cache as Linux reports it."""
    levels = Path("/sys/devices/system/cpu/cpu0/cache").glob("index*/size")
    units = {"K": 2**10, "M": 2**20, "G": 2**30}
    sizes = [path.read_text().strip() for path in levels]
    return max((int(size[:-1]) * units[size[-1]] for size in sizes if size[-1:] in units), default=0)
