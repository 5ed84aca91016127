"""The emulator runs kernels as CUDA does, and detects the errors that it is meant to detect."""

import faulthandler
import multiprocessing
import signal
from pathlib import Path

import pytest
import torch

from tests.emulator import PASSES, counted, emulated

SUMS = """
#include "platform.h"
extern "C" __global__ void sums(const int* values, int* out) {
    __shared__ int total;
    if (threadIdx.x == 0) total = 0;
    __syncthreads();
    int sum = values[blockIdx.x * blockDim.x + threadIdx.x];
    for (int by = 16; by > 0; by /= 2) sum += __shfl_xor_sync(ALL_LANES, sum, by);
    if (threadIdx.x % WARP == 0) atomicAdd(&total, sum);
    __syncthreads();
    if (threadIdx.x == 0) out[blockIdx.x] = total;
}
"""
RACE = """
#include "platform.h"
extern "C" __global__ void race(int* out) {
    __shared__ int last;
    last = threadIdx.x;
    __syncthreads();
    if (threadIdx.x == 0) *out = last;
}
"""
TURNS = """
#include "platform.h"
struct Shared { int taken; };
extern "C" __global__ void turns(int* next, int* out, int count) {
    DYNAMIC_SHARED(Shared, shared);
    for (;;) {
        __syncthreads();
        if (threadIdx.x == 0) shared.taken = atomicAdd(next, 1);
        __syncthreads();
        if (shared.taken >= count) return;
        if (threadIdx.x == 0) out[shared.taken] = blockIdx.x;
    }
}
"""
LOOPS = """
#include "platform.h"
#include "passes.h"
extern "C" __global__ void loops(int* out) {
    int sum = 0;
    for (unsigned i = 0; i < threadIdx.x % WARP; ++i) {
        PASS(row);
        sum += i;
    }
    __syncwarp();
    if (threadIdx.x < 3) {
        PASS(row);
        PASS(cell);
    }
    __syncthreads();
    if (threadIdx.x == 40) PASS(pair);
    out[threadIdx.x] = sum;
    __syncthreads();
}
"""
HALF_A_WARP = """
#include "platform.h"
extern "C" __global__ void half(int* out) {
    if (threadIdx.x < 16) *out = __any_sync(ALL_LANES, 1);
}
"""
HALF_A_MASK = HALF_A_WARP.replace("ALL_LANES, 1", "0xffffu, 1")


def source(folder: Path, text: str) -> Path:
    """Write a kernel's source to a file, and return its path."""
    path = folder / "kernel.cu"
    path.write_text(text)
    return path


def test_threads_of_a_block_sum_their_values_across_warps(tmp_path: Path) -> None:
    values, out = torch.arange(3 * 128, dtype=torch.int32), torch.zeros(3, dtype=torch.int32)
    emulated(source(tmp_path, SUMS)).launch("sums", 3, 128, values, out)
    assert torch.equal(out, values.view(3, 128).sum(1, dtype=torch.int32))


def test_a_race_between_threads_gives_different_results_for_different_seeds(tmp_path: Path) -> None:
    kernels, seen = emulated(source(tmp_path, RACE)), set()
    for seed in range(8):
        kernels.seed, out = seed, torch.zeros(1, dtype=torch.int32)
        kernels.launch("race", 1, 64, out)
        seen.add(int(out))
    assert len(seen) > 1


def test_resident_blocks_take_turns_at_shared_work(tmp_path: Path) -> None:
    taken, out = torch.zeros(1, dtype=torch.int32), torch.full((8,), -1, dtype=torch.int32)
    emulated(source(tmp_path, TURNS)).launch("turns", 3, 64, taken, out, 8)
    assert set(out[:4].tolist()) == {0, 1} and (out >= 0).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [(HALF_A_WARP, "threads wait for others that never come"), (HALF_A_MASK, "expected a collective")],
    ids=["half a warp", "half a mask"],
)
def test_a_collective_that_some_lanes_never_join_aborts_the_program(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    kernels, out = emulated(source(tmp_path, text)), torch.zeros(1, dtype=torch.int32)

    def run() -> None:
        faulthandler.disable()  # it would report the abort outside the captured output
        kernels.launch("half", 1, 32, out)

    child = multiprocessing.get_context("fork").Process(target=run)
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGABRT and said in capfd.readouterr().err


def test_a_warp_counts_the_passes_of_its_busiest_lane_between_two_barriers(tmp_path: Path) -> None:
    kernels = counted(source(tmp_path, LOOPS))
    kernels.launch("loops", 1, 64, torch.zeros(64, dtype=torch.int32))
    found = kernels.passes()
    assert found["row"] == (2 * 31 + 1, 2 * sum(range(32)) + 3)
    assert (found["cell"], found["pair"], found["key"]) == ((1, 3), (1, 1), (0, 0))
    assert not any(sum(counts) for counts in kernels.passes().values())  # the counts have been reset
    assert PASSES[0] == "node" and PASSES[-1] == "pair"
