"""Makes ``docs/tasks/<task>.jpg``: what a robot sees along a shortest path, one picture per task.

In push, the task's own teacher drives, and a second row shows robot and ball. In tasks whose goal belongs to the
episode, the robot follows shortest paths to that goal: pointnav has the depth in a second row, and imagenav ends with
the image of its goal.

Usage: python docs/tasks.py [task ...]
"""

import math
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from splatrl.building import build_world
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.configuration import load_config
from splatrl.curriculum import plan
from splatrl.datasets import planner_episodes
from splatrl.envs.drawing import Shot
from splatrl.envs.tasks import Apple, ImageNav, Outcome, Snake
from splatrl.envs.world import World

TASKS = ("grid", "fps", "apple", "sim2real", "drive", "circle", "polar_plane", "hemisphere", "poster")
"""Tasks with fixed goals to which the planner finds paths."""
WANDERING = ("snake", "pointnav", "imagenav")
"""Tasks whose goal belongs to the episode."""
TAUGHT = "push"
"""The task that its own teacher demonstrates."""
SIDE, VIEWS, GAP = 176, 5, 4
SETTINGS = [f"robot.image_width={SIDE}", f"robot.image_height={SIDE}", "device=cpu", "renderer.cache=null"]
EPISODES, SEED, APPLES = 8, 3, 2


def main() -> None:
    """Draw one of a few episodes of each task."""
    folder = Path(__file__).with_name("tasks")
    folder.mkdir(exist_ok=True)
    for task in sys.argv[1:] or (*TASKS, *WANDERING, TAUGHT):
        if task == TAUGHT or task in WANDERING:
            _page(_taught() if task == TAUGHT else _wandered(task), folder / f"{task}.jpg")
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
    """Save a few frames of each film [T, H, SIDE, 3], one film per row."""
    tops = np.cumsum([0, *(views.shape[1] + GAP for views in films)]).tolist()
    page = Image.new("RGB", (VIEWS * (SIDE + GAP) - GAP, tops[-1] - GAP), "white")
    for top, views in zip(tops, films, strict=False):
        for column, step in enumerate(_evenly(len(views), VIEWS)):
            page.paste(Image.fromarray(views[step]), (column * (SIDE + GAP), top))
    page.save(path, quality=82)


def _evenly(count: int, chosen: int) -> list[int]:
    """Return ``chosen`` evenly spaced frame indices, from the first of ``count`` to the last."""
    return np.linspace(0, count - 1, chosen).round().astype(int).tolist()


def _wandered(name: str) -> list[NDArray[np.uint8]]:
    """Return the views of the longest of a few episodes on shortest paths to their goals; in snake, to two apples."""
    world = build_world(load_config([f"task={name}", *SETTINGS]))
    episodes = [_walk(world, seed) for seed in range(EPISODES)]
    steps = max((steps for steps in episodes if int(steps[-1]["next", "outcome"]) == Outcome.GOAL), key=len)
    print(f"{name}: {len(steps)} steps")
    views = torch.cat([*(step["pixels"] for step in steps), steps[-1]["next", "pixels"]])
    if name == "pointnav":
        depth = torch.cat([*(step["depth"] for step in steps), steps[-1]["next", "depth"]])
        return [views.numpy(), (255 * depth).byte().expand(-1, -1, -1, 3).numpy()]
    if name == "imagenav":
        views = torch.cat([views[_evenly(len(views), VIEWS - 1)], steps[0]["imagegoal"]])
    return [views.numpy()]


def _walk(world: World, seed: int) -> list[TensorDictBase]:
    """Return the steps of one robot to the end of its episode, or to its second apple."""
    env = world.env(1, seed=seed)
    now, task, steps, way, aim = env.reset(), world.task, [], None, torch.empty(0)
    while len(steps) < task.max_steps:
        target = now["target" if isinstance(task, Snake) else "goal"][0]
        if way is None or not torch.equal(target, aim):
            way, aim = plan(task.motion, world.checker, partial(_there, world, target)), target.clone()
        done = bool(_there(world, target, now["state"]))
        best = way.optimal(now["state"])[0].nonzero()
        arrived = done and not isinstance(task, Snake)  # stop is action 0 of navigation
        now["action"] = torch.zeros(1, dtype=torch.int64) if arrived else way.actions[best[0] if len(best) else [0]]
        step = env.step(now)
        steps.append(step.clone())
        now = env.step_mdp(step)
        apples = sum(int(each["next", "outcome"]) == Outcome.GOAL for each in steps)
        if bool(step["next", "done"]) or apples == APPLES:
            break
    return steps


def _there(world: World, target: Tensor, state: Tensor) -> Tensor:
    """Return whether robots [B, 3] are where an episode's goal is reached: [B] bool."""
    task = world.task
    if isinstance(task, Snake):
        return Apple(task.motion, target.tolist(), task.reach / task.motion.step).reached(state)
    away = (state[:, :2] - target[:2]).norm(dim=1)
    turn = torch.cos(state[:, 2] - target[2]) if isinstance(task, ImageNav) else torch.ones(len(state))
    return (away < 0.15) & (turn > math.cos(math.radians(16)))


def _taught() -> list[NDArray[np.uint8]]:
    """Return an episode of push that ends at the mark: the robot's views, and robot and ball from behind and above."""
    world = build_world(load_config([f"task={TAUGHT}", *SETTINGS, f"robot.image_height={SIDE // 2}"]))
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
    cameras = Cameras(camera, intrinsics(math.radians(85.0), SIDE, SIDE), SIDE, SIDE)
    beside = world.drawing.draw(Shot(cameras, memory, task.parts(episode["state"], memory))).pixels
    print(f"{TAUGHT}: {len(episode)} steps")
    return [episode["pixels"].numpy(), beside.numpy()]


def _shown(film: Tensor) -> float:
    """Score how well an episode [T, H, W, 3] shows its task: long, and with the goal in view before its end."""
    change = (film[-3:-1].float() - film[-1].float()).abs().mean().item()
    return len(film) - 0.2 * change


if __name__ == "__main__":
    main()
