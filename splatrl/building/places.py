"""Builds the scenes of a config, each with its robot, task and shortest paths."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from torch import Tensor
from torchrl.envs import Transform
from tqdm import tqdm

from splatrl.bodies import Body
from splatrl.collision import NativeChecker, Occupancy
from splatrl.collision.base import Checker
from splatrl.cost_cache import remembering
from splatrl.curriculum import Plan, plan
from splatrl.device import KINDS
from splatrl.envs.drawing import Drawing
from splatrl.envs.robot import Robot
from splatrl.envs.sensors import Sensor
from splatrl.envs.tasks import Course, NavigationTask, Push, Task
from splatrl.envs.world import World, Worlds
from splatrl.misfits import check_goal, check_height
from splatrl.motions import PhysicsMotion
from splatrl.native.threads import threads_of
from splatrl.physics.survey import survey_terrain
from splatrl.scenes.scene import Bounds, Scene

BEYOND = 1.0
"""Margin, metres, around the robots' region in which physics knows the solid voxels: pushed things can roll away."""


class Place(NamedTuple):
    """One scene with its robot and task, but without rendering; the fields are those of ``World``."""

    scene: Scene
    occupancy: Occupancy
    checker: Checker
    robot: Robot
    task: Task
    plan: Plan

    def world(
        self,
        drawing: Drawing,
        transforms: Callable[[], list[Transform]],
        device: torch.device,
        sensors: Mapping[str, Sensor],
        made_by: Callable[[], World | Worlds] | None = None,
    ) -> World:
        scene, occupancy, checker, robot, task, paths = self
        return World(scene, occupancy, checker, drawing, robot, task, paths, transforms, device, made_by, sensors)


def build_places(configs: Sequence[DictConfig], device: torch.device, names: Sequence[str]) -> list[Place]:
    """Build the scenes of some configs; several are built in parallel, with a progress bar.

    Args:
        configs: configs with one scene each.
        device: device on which robots are simulated and rendered.
        names: the name that was typed for each of several scenes, for messages.
    """
    if len(configs) == 1:
        return [_build_place(configs[0], device)]
    with ThreadPoolExecutor(threads_of(None)) as pool:
        places = pool.map(partial(_build_one_of_several, device=device), names, configs)
        return list(tqdm(places, "scenes", len(configs), unit="scene", dynamic_ncols=True))


def _build_one_of_several(name: str, cfg: DictConfig, device: torch.device) -> Place:
    """Build one of several scenes, with its name in front of any error message."""
    with _key(name):
        return _build_place(cfg, device)


def _build_place(cfg: DictConfig, device: torch.device) -> Place:
    """Build the place that a config with one scene describes."""
    scene, robot, task = instantiate(cfg.scene), instantiate(cfg.robot), instantiate(cfg.task)
    check_height(scene.bounds, task)
    region = _start_region(task, robot.body)
    with _key("collision.occupancy"):
        occupancy = instantiate(cfg.collision.occupancy)(scene, *region)
    checker = constructor(cfg, "collision", device)(occupancy, robot.body)
    planner = checker if device.type == "cpu" else instantiate(cfg.collision.cpu)(occupancy, robot.body)
    solid = checker if isinstance(checker, NativeChecker) else NativeChecker(occupancy, robot.body)
    fits: Callable[[Tensor], Tensor] = partial(_fits, scene.bounds, solid)
    if isinstance(task, NavigationTask):
        with _key("task"):
            task.settle(planner, fits)
        fits = partial(_connected, task, fits)
    if isinstance(task.motion, PhysicsMotion):
        _settle(task, scene, occupancy, robot.body, bool(cfg.renderer.get("antialiased", True)))
        fits = partial(_stands, task, fits)
    paths = plan(task.motion, planner, task.reached, cfg.starts.farthest, fits, remembering(cfg, occupancy))
    return Place(scene, occupancy, checker, robot, task, paths)


def _settle(task: Task, scene: Scene, occupancy: Occupancy, body: Body, antialiased: bool) -> None:
    """Give a robot with physics, and the things that its task places, the ground of a scene to stand on."""
    motion = task.motion
    assert isinstance(motion, PhysicsMotion)
    if motion.ground == "scene":  # level ground needs no survey
        lower, upper = motion.twin.lower.tolist(), motion.twin.upper.tolist()
        with _key("task.motion"):
            reach = body.radius + (BEYOND if motion.pushed else 0.0)
            motion.settle(survey_terrain(scene, occupancy, lower, upper, reach, motion.top, antialiased).terrain)
    if isinstance(task, (Push, Course)):
        with _key("task"):
            task.settle()


def _stands(task: Task, fits: Callable[[Tensor], Tensor], body_to_world: Tensor) -> Tensor:
    """Whether robots with physics can start at poses: [S, 4, 4] -> [S] bool."""
    motion, free = task.motion, fits(body_to_world)
    assert isinstance(motion, PhysicsMotion)
    rows = free.nonzero().squeeze(1)
    x_axis, place = body_to_world[rows, :2, 0], body_to_world[rows, :2, 3]
    planar = torch.cat([place, torch.atan2(x_axis[:, 1:], x_axis[:, :1])], 1).double()
    free[rows] = motion.clear(motion.nearest(planar))
    if isinstance(task, Push):
        free[rows] &= task.connected(planar)
    return free


def check_place(cfg: DictConfig, bounds: Bounds) -> None:
    """Refuse a robot below the scene, or a goal outside the robots' region, without building the rest of the world.

    Args:
        cfg: the complete config.
        bounds: bounds of the scene, world frame, metres.

    Raises:
        ValueError: names the key, what was expected and what was given.
    """
    robot, task = instantiate(cfg.robot), instantiate(cfg.task)
    check_height(bounds, task)
    _start_region(task, robot.body)


@contextmanager
def _key(key: str) -> Iterator[None]:
    """Prefix a ``ValueError`` raised in the block with a config key."""
    try:
        yield
    except ValueError as error:
        if str(error).startswith(f"{key}."):  # it already names the key
            raise
        raise ValueError(f"{key}: {error}") from error


def constructor(cfg: DictConfig, group: str, device: torch.device) -> Callable[..., Any]:
    """Return the constructor that a config group holds for a kind of device.

    Raises:
        ValueError: if the group has no constructor for this device.
    """
    choice = OmegaConf.select(cfg, group)
    node = choice.get(device.type)
    if node is None:
        others = [kind for kind in KINDS if choice.get(kind) is not None]
        if not others:
            raise ValueError(
                f"{group}: expected a constructor for {' or '.join(KINDS)}, got {', '.join(map(str, choice))}"
            )
        raise ValueError(f"{group}: expected device={' or '.join(others)} for this choice, got device={device}")
    return instantiate(node)


def _fits(bounds: Bounds, solid: Checker, body_to_world: Tensor) -> Tensor:
    """Whether robots can start at poses, within the scene's bounds and free of collisions: [S, 4, 4] -> [S] bool."""
    lower, upper = (body_to_world.new_tensor(corner[:2]) for corner in bounds)
    place = body_to_world[:, :2, 3]
    return ((place >= lower) & (place <= upper)).all(1) & ~solid.collides(body_to_world)


def _connected(task: NavigationTask, fits: Callable[[Tensor], Tensor], body_to_world: Tensor) -> Tensor:
    """Whether a robot can start at poses and reach the goals of a navigation task: [S, 4, 4] -> [S] bool."""
    return fits(body_to_world) & task.geodesics.grounds[0].connected(body_to_world[:, :2, 3])


def _start_region(task: Task, body: Body) -> tuple[Tensor, tuple[list[float], list[float]]]:
    """Return places that robots can reach, [N, 3] in metres, and the corners of the box that contains their bodies.

    The places are those of the goal states, or of all states if the task has no goal states.
    """
    states = task.motion.states()
    places = task.motion.body_to_world(states)[:, :3, 3]
    reached = task.reached(states)
    if reached is not None:
        check_goal(task, reached)
    lower, upper = places.amin(0) - body.radius, places.amax(0) + body.radius
    return places if reached is None else places[reached], (lower.tolist(), upper.tolist())
