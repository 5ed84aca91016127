"""Makes docs/physics/gates.jpg: a quadrotor in a track of gates, from beside it and as it sees them.

python docs/gates.py
"""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image

from splatrl.build import build_world
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.configuration import load_config
from splatrl.envs.tasks import Gates, Route
from splatrl.envs.tasks.base import Anywhere, Step
from splatrl.envs.world import World

SIDE, SMALL = (900, 600), 200
"""Pixels of the view from beside, and of the robot's own."""


@dataclass(frozen=True)
class Course:
    """What a picture shows.

    Attributes:
        task: its name.
        number: of the course among those of the tests.
        every: steps between the robot's own views.
        eye: of the view from beside, metres, world.
        target: where it looks.
        at: share of the way at which it is taken.
    """

    task: str
    number: int
    every: int
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    at: float


COURSES = (
    Course("gates", 7, 15, (0.3, -2.75, 1.6), (-0.7, 0.1, 0.7), 0.5),
    Course("route", 5, 12, (0.3, -2.75, 1.6), (-0.1, 0.0, 0.0), 0.5),
)
FOV = math.radians(85.0)


def main() -> None:
    """Let the teachers do their tasks, and put views of that side by side."""
    for course in COURSES:
        draw(course)


def draw(course: Course) -> None:
    """Draw the picture of a course."""
    cfg = load_config([f"task={course.task}", f"robot.image_width={SMALL}", f"robot.image_height={SMALL}"])
    world = build_world(cfg)
    assert isinstance(world, World) and isinstance(world.task, Gates | Route)
    task, renderer, row = world.task, world.drawing.renderer, course.number
    begun = task.episodes(world.plan.starts, row + 1, 0)
    state, memory = begun["state"][row:], {key: begun[key][row:] for key in task.memory_spec}
    anywhere = Anywhere(lambda: state, torch.Generator())
    egos, flown = [], []
    for step in range(task.max_steps):
        if step % course.every == 0:
            cameras = world.robot.cameras(task.motion.body_to_world(state))
            egos.append(renderer.pixels(cameras, task.parts(state, memory))[0])
        action = task.teacher(state, memory)
        move = task.motion.move(state, action, world.checker)
        verdict = task.judge(Step(state, action, move, memory, torch.empty(0)), anywhere)
        flown.append((state, memory))
        state, memory = move.state, dict(verdict.memory)
        if verdict.terminated.any():
            break
    at, then = flown[int(course.at * len(flown))]
    view = Cameras(look_at(course.eye, course.target)[None], intrinsics(FOV, *SIDE), *SIDE)
    beside = renderer.pixels(view, task.parts(at, then))[0]
    picture = Image.new("RGB", (SIDE[0] + SMALL * 2, SIDE[1]), "white")
    picture.paste(Image.fromarray(beside.numpy()), (0, 0))
    for number, ego in enumerate(egos[:6]):
        picture.paste(Image.fromarray(ego.numpy()), (SIDE[0] + SMALL * (number % 2), SMALL * (number // 2)))
    folder = Path(__file__).parent / "physics"
    folder.mkdir(exist_ok=True)
    picture.save(folder / f"{course.task}.jpg", quality=86)


if __name__ == "__main__":
    main()
