"""How often the teachers of tasks succeed in episodes of tests.

Usage: python benchmarks/teachers.py [episodes] [override ...]
    python benchmarks/teachers.py 160 task=gates
    python benchmarks/teachers.py 256 task=push task.turn_deg=180
    python benchmarks/teachers.py 256 task=pointnav scene=kitchen
"""

import sys

import torch
from tensordict import TensorDict

from splatrl.building import build_one_world
from splatrl.configuration import load_config

SMALL = ["robot.image_width=8", "robot.image_height=8", "device=cpu"]
"""Teachers do not look."""


def main() -> None:
    """Let the teacher of one task act in test episodes, all side by side, to their ends."""
    episodes = int(sys.argv[1]) if len(sys.argv) > 1 else 160
    world = build_one_world(load_config([*(sys.argv[2:] or ["task=gates"]), *SMALL]))
    env, task = world.env(episodes), world.task
    begun = task.episodes(world.plan.starts, episodes, 0)  # type: ignore[attr-defined]
    now = env.reset(TensorDict(begun, [episodes]), set_state=True)
    ended, success, steps = torch.zeros(episodes, dtype=torch.bool), torch.zeros(episodes), torch.zeros(episodes)
    while not ended.all():
        taught = task.teach(now["state"], {key: now[key] for key in task.memory_spec})
        assert taught is not None, "a task with a teacher"
        step = env.step(now.set("action", taught.to(env.action_spec.dtype)))
        over = step["next", "done"].squeeze(1) & ~ended
        success[over] = step["next", "success"].squeeze(1)[over].float()
        steps += ~ended
        ended |= over
        now = env.step_mdp(step)
    print(f"{int(success.sum())} of {episodes} episodes, {steps.mean():.1f} steps each on average")


if __name__ == "__main__":
    main()
