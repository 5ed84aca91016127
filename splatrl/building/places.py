"""Builds the scenes of a config, each with its robot, task and shortest paths."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor
from torchrl.envs import Transform

from splatrl.bodies import Body
from splatrl.building.cost_cache import remembering
from splatrl.building.instantiation import instantiate
from splatrl.building.misfits import (
    check_goal,
    check_height,
    warn_of_cut_off,
    warn_of_far_starts,
    warn_of_no_floor,
    warn_of_uncaptured,
)
from splatrl.collision import NativeChecker, Occupancy
from splatrl.collision.base import Checker
from splatrl.collision.report import NOTHING_SOLID
from splatrl.configuration import check_config, place_configs
from splatrl.curriculum import NoPath, Plan, plan
from splatrl.device import KINDS
from splatrl.envs.drawing import Drawing
from splatrl.envs.robot import Robot
from splatrl.envs.sensors import Sensor
from splatrl.envs.tasks import Task
from splatrl.envs.world import World, Worlds
from splatrl.motions import Site
from splatrl.native.threads import threads_of
from splatrl.scenes.scene import Bounds, Scene, content_of
from splatrl.values import under_key
from splatrl.waits import Bar


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


def build_places(
    configs: Sequence[DictConfig], device: torch.device, names: Sequence[str], repeats: int = 1
) -> list[Place]:
    """Build the scenes of some configs; several are built in parallel, with a progress bar.

    Args:
        configs: configs with one scene each.
        device: device on which robots are simulated and rendered.
        names: the name that was typed for each of several scenes, for messages.
        repeats: number of times that a robot carries out each action.

    Raises:
        ValueError: for several scenes, before any is built, with a motion that takes one; or for a scene in which the
            robot or the task does not fit.
    """
    if len(configs) == 1:
        return [_build_place(configs[0], device, repeats)]
    if not instantiate(configs[0].task).motion.stacks:
        raise ValueError(f"scene: expected one scene for a robot with physics, got {len(configs)}")
    with ThreadPoolExecutor(threads_of(None)) as pool:
        places = pool.map(partial(_build_one_of_several, device=device, repeats=repeats), names, configs)
        return list(Bar(places, "scenes", len(configs), unit="scene"))


def _build_one_of_several(name: str, cfg: DictConfig, device: torch.device, repeats: int) -> Place:
    """Build one of several scenes, with its name in front of any error message."""
    with under_key(name):
        return _build_place(cfg, device, repeats)


def _build_place(cfg: DictConfig, device: torch.device, repeats: int) -> Place:
    """Build the place that a config with one scene describes."""
    scene, robot, task = instantiate(cfg.scene), instantiate(cfg.robot), instantiate(cfg.task)
    check_height(scene.bounds, task)
    region = start_region(task, robot.body)
    with under_key("collision.occupancy"):
        occupancy = instantiate(cfg.collision.occupancy)(scene, *region)
    if occupancy.count == 0:
        warnings.warn(f"{scene.name}: {NOTHING_SOLID}", stacklevel=2)
    checker = constructor(cfg, "collision", device)(occupancy, robot.body)
    antialiased = bool(cfg.renderer.get("antialiased", True))
    with under_key("task.motion"):
        obstacles = task.motion.obstacles(scene, occupancy, antialiased)
    shared = device.type == "cpu" and obstacles is occupancy
    planner = checker if shared else instantiate(cfg.collision.cpu)(obstacles, robot.body)
    solid = planner if isinstance(planner, NativeChecker) else NativeChecker(obstacles, robot.body)
    warn_of_uncaptured(scene, task, solid)
    with under_key("task"):
        fits = task.settle(
            Site(scene, occupancy, planner, robot.body, antialiased, repeats=repeats),
            partial(_fits, scene.bounds, solid),
        )
    try:
        costs, limit = remembering(cfg, obstacles), task.max_steps if task.goals_for_success is None else None
        paths = plan(task.motion, planner, task.reached, cfg.starts.farthest, fits, costs, repeats, limit)
    except NoPath as error:
        raise ValueError(f"{error}; {task.ways_out}") from error
    warn_of_cut_off(scene, paths)
    warn_of_far_starts(scene, paths)
    warn_of_no_floor(scene, paths, occupancy)
    return Place(scene, occupancy, checker, robot, task, paths)


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
    start_region(task, robot.body)


def scene_digest(cfg: DictConfig) -> str:
    """Return the ``digest`` of the world that a config describes; only its scenes are built, one after another.

    Raises:
        ValueError: for a value that is missing, or a scene that cannot be read.
    """
    check_config(cfg)
    return content_of(instantiate(one.scene) for one in place_configs(cfg))


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


def start_region(task: Task, body: Body) -> tuple[Tensor, tuple[list[float], list[float]]]:
    """Return places that robots can reach, [N, 3] in metres, and the corners of the box that contains their bodies.

    The places are those of the goal states, or of all states if the task has no goal states.
    """
    states = task.motion.states()
    places = task.motion.body_to_world(states)[:, :3, 3]
    reached = task.reached(states)
    if reached is not None:
        check_goal(task, reached)
    lower, upper = task.motion.region()
    margin = body.radius + lower.new_tensor([task.leeway, task.leeway, 0.0])
    lower, upper = lower - margin, upper + margin
    return places if reached is None else places[reached], (lower.tolist(), upper.tolist())
