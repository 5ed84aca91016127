"""Soak test: over many steps and envs, the process must not accumulate memory, descriptors or threads.

    python benchmarks/soak.py                          # 10⁷ steps with resets, then 1,000 envs built and closed
    python benchmarks/soak.py --steps 1e5 --envs 20    # a quick trial

Each part runs in ten rounds. After the last round, the process may hold no more descriptors and threads than after the
first, and only ``ALLOWED`` bytes more memory; otherwise the exit status is 1.
"""

import argparse
import gc
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
from machine import MEBIBYTE
from tqdm import tqdm

import splatrl

ROUNDS = 10
BATCH = 512
ALLOWED = 32 * MEBIBYTE
"""Bytes by which the memory may exceed that of the first round, since the allocator keeps a varying amount."""
SETTINGS = ["device=cpu", "task.max_steps=40", "robot.image_width=16", "robot.image_height=16"]


class Held(NamedTuple):
    """Resources of the process: resident bytes, open descriptors, threads of Python, and threads of the system."""

    memory: int
    descriptors: int
    threads: int
    tasks: int

    @staticmethod
    def now() -> "Held":
        """Read the current values from Linux."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        counts = (len(os.listdir(f"/proc/self/{kind}")) for kind in ("fd", "task"))
        descriptors, tasks = counts
        return Held(pages * os.sysconf("SC_PAGE_SIZE"), descriptors, threading.active_count(), tasks)

    def __str__(self) -> str:
        memory = f"{self.memory / MEBIBYTE:8.1f} MiB"
        return f"{memory}, {self.descriptors} descriptors, {self.threads} Python threads, {self.tasks} system threads"


def stepping() -> Callable[[int], None]:
    """Return a function that makes a number of random steps of single robots, with TorchRL's automatic resets."""
    env = splatrl.make_env(SETTINGS, batch_size=[BATCH])
    torch.manual_seed(0)
    state = [env.reset()]

    def step(count: int) -> None:
        for _ in range(count // BATCH):
            _, state[0] = env.step_and_maybe_reset(env.rand_action(state[0]))

    return step


def making() -> Callable[[int], None]:
    """Return a function that builds a number of envs, each of which is reset, stepped and closed."""

    def make(count: int) -> None:
        for _ in range(count):
            env = splatrl.make_env(SETTINGS, batch_size=[4])
            env.step(env.rand_action(env.reset()))
            env.close()

    return make


def soak(name: str, work: Callable[[int], None], total: int) -> bool:
    """Work in rounds, print the resources after each, and return whether they stayed within the limits."""
    held = []
    for number in tqdm(range(ROUNDS), desc=name, unit="round"):
        work(total // ROUNDS)
        held.append(Held.now())
        tqdm.write(f"{name} {(number + 1) * (total // ROUNDS):>12,}  {held[-1]}")
    flat = held[-1].memory <= held[0].memory + ALLOWED and held[-1][1:] <= held[0][1:]
    print(f"{name}: {'flat' if flat else 'GROWS'}")
    return flat


def main() -> int:
    """Run both parts, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=float, default=1e7, help="total number of steps of single robots")
    parser.add_argument("--envs", type=float, default=1e3, help="number of envs to build and close")
    options = parser.parse_args()
    torch.set_num_threads(1)
    results = [soak("steps", stepping(), int(options.steps)), soak("envs", making(), int(options.envs))]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
