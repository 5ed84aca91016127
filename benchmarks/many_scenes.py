"""Compares rendered steps of robots in many yards with as many robots in one yard: python benchmarks/many_scenes.py

In the mixed batch, each of the ``--yards`` yards has one robot. For comparison, all robots are placed in each yard in
turn, and the times are averaged over the yards. Also prints the time to build the yards from a warm cache and the
memory of the process. Values are medians over interleaved rounds.
"""

import argparse
import time
from statistics import median

import torch
from machine import measured_machine
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.curriculum import Curriculum
from splatrl.envs.world import World, Worlds


def resident() -> float:
    """Return the resident memory of this process, GiB."""
    with open("/proc/self/status") as status:
        line = next(line for line in status if line.startswith("VmRSS"))
    return int(line.split()[1]) / 2**20


def begun(env: EnvBase, scenes: torch.Tensor, curriculum: Curriculum) -> TensorDictBase:
    """Reset robots in given scenes to states from the whole start set, with random actions."""
    states = curriculum.anywhere(len(scenes), torch.Generator().manual_seed(0), scenes)
    given = TensorDict({"state": states, "scene": scenes.unsqueeze(1)}, batch_size=env.batch_size)
    return env.rand_action(env.reset(given, set_state=True))


def from_warm_cache(task: str, count: int) -> tuple[World | Worlds, float]:
    """Build the world of a task in some yards twice, and return it with the seconds of the second time."""
    words = [f"task={task}", "scene=yards", f"scene.count={count}"]
    build_world(load_config(words))
    start = time.perf_counter()
    return build_world(load_config(words)), time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--yards", type=int, default=64, help="number of yards, and of robots")
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    count = options.yards
    before = resident()
    world, built = from_warm_cache("fps", count)
    held = resident() - before
    curriculum = Curriculum([one.plan for one in world.worlds], first=None)
    env = world.env(count, curriculum)
    mixed = begun(env, torch.arange(count), curriculum)
    alone = [begun(env, torch.full((count,), number), curriculum) for number in range(count)]
    ratios, rates = [], []
    for _ in range(options.rounds):
        times = []
        for td in alone:
            start = time.perf_counter()
            env.step(td.clone())
            times.append(time.perf_counter() - start)
        start = time.perf_counter()
        for _ in range(4):
            env.step(mixed.clone())
        together = (time.perf_counter() - start) / 4
        ratios.append(sum(times) / count / together)
        rates.append(count / together)
    print(measured_machine())
    print(f"{count} yards from a warm cache: {built:.1f} s; memory {held:.2f} GiB")
    print(f"{count} yards of task=pointnav from a warm cache: {from_warm_cache('pointnav', count)[1]:.1f} s")
    print(f"mixed batch of {count}: {median(rates):,.0f} rendered steps/s, {median(ratios):.2f} times one yard's")
    print(f"ratios of {options.rounds} rounds: {min(ratios):.2f} to {max(ratios):.2f}")


if __name__ == "__main__":
    main()
