"""Measures how often the teachers of tasks succeed in test episodes.

Usage: python benchmarks/teachers.py [episodes] [override ...]
    python benchmarks/teachers.py 160 task=gates
    python benchmarks/teachers.py 256 task=push task.turn_deg=180
    python benchmarks/teachers.py 256 task=pointnav scene=kitchen
"""

import sys

from splatrl.building import build_one_world
from splatrl.configuration import load_config
from splatrl.evaluation.rollouts import knowing, run_episodes

SMALL = ["robot.image_width=8", "robot.image_height=8", "device=cpu"]
"""Overrides that keep images small, since teachers do not look at them."""


def main() -> None:
    """Let the teacher of a task act in a batch of test episodes until all have ended."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 160
    world = build_one_world(load_config([*(sys.argv[2:] or ["task=gates"]), *SMALL]))
    begun, env = world.task.episodes(world.plan.starts, count, 0), world.env(count)  # type: ignore[attr-defined]
    found = run_episodes(env, knowing(env, world.task.teach), begun.pop("state"), memory=begun)
    spl = f", SPL {found.navigation()['spl']:.3f}" if found.measures else ""
    print(f"{int(found.success.sum())} of {count} episodes, {found.length.double().mean():.1f} steps each{spl}")


if __name__ == "__main__":
    main()
