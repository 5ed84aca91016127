"""Makes the pictures in docs/physics: the ground of the backyard, and a quadrotor, a car and a quadruped underway.

python docs/courses.py
"""

import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from PIL import Image

from splatrl.building import build_world
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.collision import Occupancy
from splatrl.configuration import load_config
from splatrl.envs.tasks import Course
from splatrl.envs.tasks.base import Anywhere, Step
from splatrl.envs.world import World
from splatrl.evaluation.terrain_pictures import draw_terrain
from splatrl.physics.survey import survey_terrain
from splatrl.scenes import backyard

FOLDER = Path(__file__).parent / "physics"
SIDE, SMALL = (900, 600), 200
"""Sizes of the view from the side and of the robot's own view, pixels."""


@dataclass(frozen=True)
class Shown:
    """Settings of a picture.

    Attributes:
        task: name of the task.
        number: index of the course among those of the tests.
        every: steps between the robot's own views.
        eye: position of the camera at the side, world frame, metres.
        target: point at which it looks, world frame, metres.
        at: fraction of the episode at which its picture is taken.
    """

    task: str
    number: int
    every: int
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    at: float


COURSES = (
    Shown("gates", 7, 15, (0.3, -2.75, 1.6), (-0.7, 0.1, 0.7), 0.5),
    Shown("route", 20, 12, (2.1, -2.3, 1.5), (0.1, -0.2, 0.0), 0.42),
    Shown("walk", 4, 8, (-2.0, -2.15, 0.65), (-0.85, -1.1, 0.2), 0.93),
)
FOV = math.radians(85.0)


def main() -> None:
    """Draw the ground, let the teachers do their tasks, and combine views of that into pictures."""
    FOLDER.mkdir(exist_ok=True)
    draw_ground()
    for course in COURSES:
        draw(course)


def draw_ground() -> None:
    """Draw the backyard's terrain as physics has it, like ``splatrl-scene``."""
    scene, lower, upper = backyard(), (-1.0, -1.0), (1.0, 1.0)
    occupancy = Occupancy.from_scene(scene, [[0.6, 0.4, 0.4]], ((-1.3, -1.3, 0.0), (1.3, 1.3, 1.2)), fill=0.2)
    surveyed = survey_terrain(scene, occupancy, lower, upper, reach=0.3, top=0.6)
    with TemporaryDirectory() as folder:
        draw_terrain(scene.gaussians, surveyed, lower, upper, Path(folder) / "ground.png")
        Image.open(Path(folder) / "ground.png").convert("RGB").save(FOLDER / "ground.jpg", quality=86)


def draw(course: Shown) -> None:
    """Draw the picture of a course."""
    cfg = load_config([f"task={course.task}", f"robot.image_width={SMALL}", f"robot.image_height={SMALL}"])
    world = build_world(cfg)
    assert isinstance(world, World) and isinstance(world.task, Course)
    task, renderer, row = world.task, world.drawing.renderer, course.number
    begun = task.episodes(world.plan.starts, row + 1, 0)
    state, memory = begun["state"][row:], {key: begun[key][row:] for key in task.memory_spec}
    anywhere = Anywhere(lambda: state, torch.Generator())
    egos, flown = [], []
    for step in range(task.max_steps):
        if step % course.every == 0:
            cameras = world.robot.cameras(task.motion.body_to_world(state))
            egos.append(renderer.pixels(cameras, task.parts(state, memory))[0])
        action = task.teach(state, memory)
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
    picture.save(FOLDER / f"{course.task}.jpg", quality=86)


if __name__ == "__main__":
    main()
