"""Makes ``docs/tasks/<task>.jpg``: what a robot sees along a shortest path, one picture for each task.

Of push it is what the robot sees as the task's own teacher drives it, with a second row that shows robot and ball.

Usage: python docs/tasks.py [task ...]
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from tensordict import TensorDict
from torch import Tensor

from splatrl.build import build_world
from splatrl.cameras import Cameras, look_at
from splatrl.configuration import load_config
from splatrl.datasets import planner_episodes

TASKS = ("grid", "fps", "apple", "sim2real", "drive", "circle", "polar_plane", "hemisphere")
"""Those with goals to which the planner can walk."""
TAUGHT = "push"
"""A task with a teacher of its own."""
SIDE, VIEWS, GAP = 176, 5, 4
SETTINGS = [f"robot.image_width={SIDE}", f"robot.image_height={SIDE}", "device=cpu", "renderer.cache=null"]
EPISODES, SEED = 8, 3


def main() -> None:
    """Draw one of a few episodes of each task."""
    folder = Path(__file__).with_name("tasks")
    folder.mkdir(exist_ok=True)
    for task in sys.argv[1:] or (*TASKS, TAUGHT):
        if task == TAUGHT:
            _page(_taught(), folder / f"{task}.jpg")
            continue
        world = build_world(load_config([f"task={task}", *SETTINGS]))
        frames = planner_episodes(world, EPISODES, SEED).frames
        walks = [frames[frames["episode"] == number] for number in range(EPISODES)]
        last = torch.stack([walk["next", "state"][-1] for walk in walks])
        goals = world.env(EPISODES).reset(TensorDict({"state": last}, [EPISODES]), set_state=True)["pixels"][..., -3:]
        films = [torch.cat([walk["pixels"][..., -3:], goal[None]]) for walk, goal in zip(walks, goals, strict=True)]
        views = max(films, key=_shown).numpy()
        _page([views], folder / f"{task}.jpg")
        print(f"{task}: {len(views)} steps")


def _page(films: Sequence[NDArray[np.uint8]], path: Path) -> None:
    """Write a few frames of each film [T, SIDE, SIDE, 3], one film below the other."""
    page = Image.new("RGB", (VIEWS * (SIDE + GAP) - GAP, len(films) * (SIDE + GAP) - GAP), "white")
    for row, views in enumerate(films):
        for column, step in enumerate(np.linspace(0, len(views) - 1, VIEWS).round().astype(int)):
            page.paste(Image.fromarray(views[step]), (column * (SIDE + GAP), row * (SIDE + GAP)))
    page.save(path, quality=82)


def _taught() -> list[NDArray[np.uint8]]:
    """An episode of push that ends at the mark: what the robot sees, and robot and ball seen from behind and above."""
    world = build_world(load_config([f"task={TAUGHT}", *SETTINGS]))
    env, task = world.env(EPISODES), world.task
    given = task.episodes(world.plan.starts, EPISODES, SEED)
    now = env.reset(TensorDict(given, [EPISODES]), set_state=True)
    steps = []
    while len(steps) < task.max_steps:
        memory = {key: now[key] for key in task.memory_spec}
        steps.append(now.select("pixels", "state", *memory).clone())
        now = env.step_mdp(env.step(now.set("action", task.teach(now["state"], memory))))
    whole = torch.stack(steps, 1)
    apart = (whole["ball"] - whole["mark"])[..., :2].norm(dim=-1)
    reached = (apart < task.success_distance).int()
    length = torch.where(reached.any(1), reached.argmax(1), 0)
    episode = whole[length.argmax(), : int(length.max()) + 1]
    robot, memory = task.motion.body_to_world(episode["state"]), {key: episode[key] for key in task.memory_spec}
    middle = 0.5 * (episode["mark"][0] + episode["ball"][0])
    eye = middle + torch.tensor([0.0, 0.0, 1.0]) - 1.6 * torch.nn.functional.normalize(middle - robot[0, :3, 3], dim=0)
    camera = look_at(eye.tolist(), middle.tolist()).expand(len(episode), 4, 4)
    cameras = Cameras(camera, world.robot.K, SIDE, SIDE)
    beside = world.drawing.draw(cameras, memory, task.parts(episode["state"], memory)).pixels
    print(f"{TAUGHT}: {len(episode)} steps")
    return [episode["pixels"].numpy(), beside.numpy()]


def _shown(film: Tensor) -> float:
    """How well an episode [T, H, W, 3] shows what it is about: long, and with the goal in view before its end."""
    change = (film[-3:-1].float() - film[-1].float()).abs().mean().item()
    return len(film) - 0.2 * change


if __name__ == "__main__":
    main()
