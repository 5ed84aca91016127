"""Makes ``docs/tasks/<task>.jpg``: what a robot sees along a shortest path, one picture for each task.

Usage: python docs/tasks.py [task ...]
"""

import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from tensordict import TensorDict

from splatrl.build import build_world
from splatrl.configuration import load_config
from splatrl.datasets import planner_episodes

TASKS = ("grid", "fps", "apple", "sim2real", "drive", "circle", "polar_plane", "hemisphere")
"""Those with goals to which the planner can walk."""
SIDE, VIEWS, GAP = 176, 5, 4
SETTINGS = [f"robot.image_width={SIDE}", f"robot.image_height={SIDE}", "device=cpu", "renderer.cache=null"]
EPISODES, SEED = 8, 3


def main() -> None:
    """Draw the longest of a few episodes of each task."""
    folder = Path(__file__).with_name("tasks")
    folder.mkdir(exist_ok=True)
    for task in sys.argv[1:] or TASKS:
        world = build_world(load_config([f"task={task}", *SETTINGS]))
        frames = planner_episodes(world, EPISODES, SEED).frames
        episode = np.asarray(frames["episode"])
        rows = torch.from_numpy(np.flatnonzero(episode == np.bincount(episode).argmax()))
        last = TensorDict({"state": frames["next", "state"][rows[-1:]]}, batch_size=[1])
        goal = world.env(1).reset(last, set_state=True)["pixels"]
        views = np.asarray(torch.cat([frames["pixels"][rows], goal]))[..., -3:]
        page = Image.new("RGB", (VIEWS * (SIDE + GAP) - GAP, SIDE), "white")
        for column, step in enumerate(np.linspace(0, len(views) - 1, VIEWS).round().astype(int)):
            page.paste(Image.fromarray(views[step]), (column * (SIDE + GAP), 0))
        page.save(folder / f"{task}.jpg", quality=82)
        print(f"{task}: {len(views)} steps")


if __name__ == "__main__":
    main()
