"""Steps and environments without end: memory, descriptors and threads of the process must stay where they are.

    python benchmarks/soak.py                          # 10⁷ steps with resets, 1,000 envs made and closed
    python benchmarks/soak.py --steps 1e5 --envs 20    # a try

Each part is done in ten rounds. The figures of the first tell what the process needs; the last must not exceed them by
more than the bytes that are allowed. Exits with status 1 where they do.
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
"""Bytes by which the last round may exceed the first: what the allocator keeps differs from round to round."""
SETTINGS = ["device=cpu", "task.max_steps=40", "robot.image_width=16", "robot.image_height=16"]


class Held(NamedTuple):
    """What the process holds: bytes of memory, open descriptors, threads of Python and of the system."""

    memory: int
    descriptors: int
    threads: int
    tasks: int

    @staticmethod
    def now() -> "Held":
        """As Linux tells it."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        counts = (len(os.listdir(f"/proc/self/{kind}")) for kind in ("fd", "task"))
        descriptors, tasks = counts
        return Held(pages * os.sysconf("SC_PAGE_SIZE"), descriptors, threading.active_count(), tasks)

    def __str__(self) -> str:
        memory = f"{self.memory / MEBIBYTE:8.1f} MiB"
        return f"{memory}, {self.descriptors} descriptors, {self.threads} threads of Python, {self.tasks} of the system"


def stepping() -> Callable[[int], None]:
    """So many steps of single robots, at random, with TorchRL's automatic resets."""
    env = splatrl.make_env(SETTINGS, batch_size=[BATCH])
    torch.manual_seed(0)
    state = [env.reset()]

    def step(count: int) -> None:
        for _ in range(count // BATCH):
            _, state[0] = env.step_and_maybe_reset(env.rand_action(state[0]))

    return step


def making() -> Callable[[int], None]:
    """So many envs, each reset, stepped and closed."""

    def make(count: int) -> None:
        for _ in range(count):
            env = splatrl.make_env(SETTINGS, batch_size=[4])
            env.step(env.rand_action(env.reset()))
            env.close()

    return make


def soak(name: str, work: Callable[[int], None], total: int) -> bool:
    """Work in rounds and print what the process holds after each; whether it stayed the same."""
    held = []
    for number in tqdm(range(ROUNDS), desc=name, unit="round"):
        work(total // ROUNDS)
        held.append(Held.now())
        tqdm.write(f"{name} {(number + 1) * (total // ROUNDS):>12,}  {held[-1]}")
    flat = held[-1].memory <= held[0].memory + ALLOWED and held[-1][1:] <= held[0][1:]
    print(f"{name}: {'flat' if flat else 'GROWS'}")
    return flat


def main() -> int:
    """Both parts; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=float, default=1e7, help="of single robots")
    parser.add_argument("--envs", type=float, default=1e3)
    options = parser.parse_args()
    torch.set_num_threads(1)
    results = [soak("steps", stepping(), int(options.steps)), soak("envs", making(), int(options.envs))]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
