"""Makes ``docs/tasks/<task>.jpg``: what a robot sees along a shortest path, one picture for each task.

Usage: python docs/tasks.py [task ...]
"""

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from tensordict import TensorDict
from torch import Tensor

from splatrl.build import build_world
from splatrl.configuration import load_config
from splatrl.datasets import planner_episodes

TASKS = ("grid", "fps", "apple", "sim2real", "drive", "circle", "polar_plane", "hemisphere")
"""Those with goals to which the planner can walk."""
SIDE, VIEWS, GAP = 176, 5, 4
SETTINGS = [f"robot.image_width={SIDE}", f"robot.image_height={SIDE}", "device=cpu", "renderer.cache=null"]
EPISODES, SEED = 8, 3


def main() -> None:
    """Draw one of a few episodes of each task."""
    folder = Path(__file__).with_name("tasks")
    folder.mkdir(exist_ok=True)
    for task in sys.argv[1:] or TASKS:
        world = build_world(load_config([f"task={task}", *SETTINGS]))
        frames = planner_episodes(world, EPISODES, SEED).frames
        walks = [frames[frames["episode"] == number] for number in range(EPISODES)]
        last = torch.stack([walk["next", "state"][-1] for walk in walks])
        goals = world.env(EPISODES).reset(TensorDict({"state": last}, [EPISODES]), set_state=True)["pixels"][..., -3:]
        films = [torch.cat([walk["pixels"][..., -3:], goal[None]]) for walk, goal in zip(walks, goals, strict=True)]
        views = max(films, key=_shown).numpy()
        page = Image.new("RGB", (VIEWS * (SIDE + GAP) - GAP, SIDE), "white")
        for column, step in enumerate(np.linspace(0, len(views) - 1, VIEWS).round().astype(int)):
            page.paste(Image.fromarray(views[step]), (column * (SIDE + GAP), 0))
        page.save(folder / f"{task}.jpg", quality=82)
        print(f"{task}: {len(views)} steps")


def _shown(film: Tensor) -> float:
    """How well an episode [T, H, W, 3] shows what it is about: long, and with the goal in view before its end."""
    change = (film[-3:-1].float() - film[-1].float()).abs().mean().item()
    return len(film) - 0.2 * change


if __name__ == "__main__":
    main()
