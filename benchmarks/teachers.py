"""Measures how often the teachers of tasks succeed in test episodes.

Usage: python benchmarks/teachers.py [episodes] [override ...]
    python benchmarks/teachers.py 160 task=gates
    python benchmarks/teachers.py 256 task=push task.turn_deg=180
    python benchmarks/teachers.py 256 task=pointnav scene=kitchen
    python benchmarks/teachers.py 192 yards task=pointnav  (a table of yards and bodies)
"""

import sys
import time

from torch import Tensor

from splatrl.building import build_one_world
from splatrl.configuration import load_config
from splatrl.envs.tasks.base import Memory
from splatrl.evaluation.rollouts import knowing, run_episodes

SMALL = ["robot.image_width=8", "robot.image_height=8", "device=cpu"]
"""Overrides that keep images small, since teachers do not look at them."""
YARDS = (5, 8, 11, 14, 17, 20, 23)
BODIES = ("round", "box", "small", "point")


def measured(count: int, overrides: list[str]) -> str:
    """Let the teacher of a task act in a batch of test episodes until all have ended, and tell how it did."""
    world = build_one_world(load_config([*overrides, *SMALL]))
    begun, env = world.task.episodes(world.plan.starts, count, 0), world.env(count)  # type: ignore[attr-defined]
    seconds, actions = 0.0, 0

    def teach(state: Tensor, memory: Memory) -> Tensor | None:
        nonlocal seconds, actions
        started = time.process_time()
        action = world.task.teach(state, memory)
        seconds, actions = seconds + time.process_time() - started, actions + len(state)
        return action

    found = run_episodes(env, knowing(env, teach), begun.pop("state"), memory=begun)
    told = f"{int(found.success.sum())} of {count} episodes, {found.length.double().mean():.1f} steps each"
    if found.measures:
        means = found.navigation()
        told += f", SPL {means['spl']:.3f}, {means['collisions']:.2f} collisions each"
    return f"{told}, {1e6 * seconds / actions:.0f} µs of CPU time per action"


def main() -> None:
    """Measure one teacher, or print a table of yards and bodies."""
    count, overrides = int(sys.argv[1]) if len(sys.argv) > 1 else 160, sys.argv[2:] or ["task=gates"]
    if overrides[0] != "yards":
        print(measured(count, overrides))
        return
    for yard in YARDS:
        for body in BODIES:
            told = measured(count, [*overrides[1:], f"scene=yard:{yard}", f"robot={body}"])
            print(f"yard {yard:2}, {body:5}: {told}", flush=True)


if __name__ == "__main__":
    main()
