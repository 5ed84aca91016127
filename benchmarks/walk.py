"""Measures how well the blind quadruped follows commanded velocities: with the trot alone, and with a gait's policy.

Usage: python benchmarks/walk.py [episodes] [gait] [override ...]
    python benchmarks/walk.py 256 quadruped
    python benchmarks/walk.py 256 outputs/2026-01-31/12-00-00/gait.npz task.motion.variation.models=64 \
        'task.motion.variation.friction=[0.6,1.2]'

In each episode the robot starts in a perturbed stance on a level plane and follows four commands of 0.3 to 0.8 m/s and
up to 0.8 rad/s, for 2.5 s each. The error is the distance between the commanded velocity along the ground and that of
the torso, averaged over steps of 20 ms.
"""

import sys
from collections.abc import Callable

import torch
from tensordict import TensorDict
from torch import Tensor

from splatrl.building import build_one_world
from splatrl.configuration import load_config
from splatrl.envs.tasks import Outcome, Strides
from splatrl.motions.legs import FELT, JOINTS
from splatrl.physics.dense import Dense
from splatrl.physics.robots import gait_path

COMMANDS = ["task=strides", "task.forward=[0.3,0.8]", "device=cpu"]


def main() -> None:
    """Run the same episodes with and without a gait, and print the results."""
    episodes = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    gait = Dense.load(gait_path(sys.argv[2] if len(sys.argv) > 2 else "quadruped"), FELT, JOINTS)
    world = build_one_world(load_config([*COMMANDS, *sys.argv[3:]]))
    for name, policy in {"trot alone": lambda felt: torch.zeros(len(felt), JOINTS), "with the gait": gait}.items():
        env, task = world.env(episodes), world.task
        assert isinstance(task, Strides)
        begun = task.episodes(world.plan.starts, episodes, 0)
        walked(name, env, TensorDict(begun, [episodes]), policy, task.max_steps)


def walked(name: str, env, begun: TensorDict, policy: Callable[[Tensor], Tensor], most: int) -> None:
    """Run a batch of episodes to their ends, and print falls, successes, errors and the reward per step."""
    now, motion = env.reset(begun, set_state=True), env.task.motion
    ended, won = (torch.zeros(len(now), dtype=torch.bool) for _ in range(2))
    fell, reward, astray, frames = torch.zeros(len(now), dtype=torch.bool), 0.0, 0.0, 0
    error = torch.zeros(len(now))
    while not ended.all():
        asked = motion.command(now["state"])
        step = env.step(now.set("action", policy(now["felt"])))
        after = step["next"]
        on = ~ended
        reward += float(after["reward"].squeeze(1)[on].sum())
        astray += float((motion.level_velocity(after["state"])[:, 2] - asked[:, 1]).abs()[on].sum())
        frames += int(on.sum())
        over = after["done"].squeeze(1) & on
        won |= over & after["success"].squeeze(1)
        fell |= over & (after["outcome"].squeeze(1) == Outcome.COLLISION)
        error[over] = (after["error"] / after["strides"]).squeeze(1)[over]
        ended |= over
        now = env.step_mdp(step)
    print(
        f"{name}: {int(fell.sum())} of {len(now)} fell within {most * 0.02:g} s, error {error.mean():.3f} m/s on "
        f"average and {error.max():.3f} at most, {astray / frames:.3f} rad/s; {int(won.sum())} succeeded; "
        f"reward {reward / frames:.3f} per step"
    )


if __name__ == "__main__":
    main()
