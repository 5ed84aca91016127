"""From configs to objects: the one place that knows which node builds what."""

import inspect
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from torch import Tensor
from torchrl.envs import Compose, EnvBase, ExcludeTransform, Transform, TransformedEnv
from torchrl.modules import ActorValueOperator

from splatrl.collision import NativeChecker
from splatrl.collision.base import Checker
from splatrl.collision.occupancy import Occupancy
from splatrl.configuration import load_config, require_values
from splatrl.curriculum import Curriculum, Plan, plan
from splatrl.curriculum.field import PlanarMotion
from splatrl.curriculum.planner import FiniteMotion
from splatrl.device import chosen_device, cuda_extra
from splatrl.envs.robot import Robot
from splatrl.envs.splat_env import SplatEnv
from splatrl.envs.tasks import Task
from splatrl.envs.transforms import sprite_among
from splatrl.renderers.base import Renderer
from splatrl.scenes.scene import Bounds, Scene
from splatrl.training import memory_transforms

TRANSFORMS = ("pose_noise", "sprite", "goal", "appearance", "stack")
"""The order in which transforms stand around the env, the innermost first."""


@dataclass(frozen=True)
class World:
    """Everything that envs of one configuration share.

    Attributes:
        scene: Gaussians in the world frame.
        occupancy: what is solid.
        checker: tests the robot's body against it.
        renderer: makes the pixels, and remembers them.
        robot: body and camera.
        task: goal, motion and rewards.
        plan: free poses and shortest paths.
        make_transforms: makes new transforms for an env, the innermost first.
        device: of its envs, unless they are given another.
    """

    scene: Scene
    occupancy: Occupancy
    checker: Checker
    renderer: Renderer
    robot: Robot
    task: Task
    plan: Plan
    make_transforms: Callable[[], list[Transform]]
    device: torch.device

    def env(
        self,
        num_envs: int,
        curriculum: Curriculum | None = None,
        seed: int | None = 0,
        device: torch.device | str | None = None,
    ) -> EnvBase:
        """A batch of robots in this world, under its transforms.

        Args:
            num_envs: number of robots.
            curriculum: where episodes begin; None lets them begin anywhere in the start set.
            seed: of the env's generator.
            device: of its tensors; None takes the world's.
        """
        device = self.device if device is None else device
        curriculum = curriculum or Curriculum(self.plan, first=None)
        transforms = self.make_transforms()
        env = SplatEnv(
            self.renderer,
            self.checker,
            self.robot,
            deepcopy(self.task),  # an env takes its task along to its device; the plan stays
            curriculum,
            [num_envs],
            seed,
            device,
            depth=sprite_among(transforms) is not None,
        )
        return TransformedEnv(env, Compose(*transforms)) if transforms else env


def build_world(cfg: DictConfig) -> World:
    """Build scene, robot, task, collision, renderer and plan from a config, for the device that it names.

    Paths are planned on the CPU, with the checker of the CPU where the robots' own is a GPU's.

    Raises:
        ValueError: for a value that is still to be given, or that one of them refuses.
    """
    require_values(cfg)
    device = chosen_device(cfg.device)
    scene, robot, task = instantiate(cfg.scene), instantiate(cfg.robot), instantiate(cfg.task)
    occupancy = instantiate(cfg.collision.occupancy)(scene, *_start_region(task.motion, task.reached, robot))
    checker, on_gpu = _made(cfg.collision, "checker", device)(occupancy, robot.body)
    solid = NativeChecker(occupancy, robot.body)
    planner = solid if on_gpu else checker
    renderer, _ = _made(cfg.renderer, "views", device)(scene)
    if cfg.renderer.memory is not None and _node(cfg.renderer, "views", device) is cfg.renderer.views:
        renderer = instantiate(cfg.renderer.memory)(renderer)
    return World(
        scene,
        occupancy,
        checker,
        renderer,
        robot,
        task,
        plan(task.motion, planner, task.reached, cfg.starts.farthest, partial(_fits, scene.bounds, solid)),
        partial(_make_transforms, cfg.transforms, robot, cfg.network.get("memory", 0)),
        device,
    )


def _node(group: DictConfig, name: str, device: torch.device) -> DictConfig:
    """What a config group says for a device: its node ``gpu`` if it has one, where that is a GPU."""
    return group.get("gpu", group[name]) if device.type == "cuda" else group[name]


def _made(group: DictConfig, name: str, device: torch.device) -> Callable[..., tuple[Any, bool]]:
    """A constructor of what a config group says for a device; it also tells whether that lives on a GPU.

    Raises:
        ValueError: for a GPU's where the device is none, or the extra that it needs is missing.
    """
    target = _node(group, name, device)._target_
    if ".cuda." in target and not cuda_extra():
        raise ValueError(f"{target}: expected the extra cuda, which is not installed: pip install 'splatrl[cuda]'")
    make = instantiate(_node(group, name, device))
    if "device" not in inspect.signature(make).parameters:
        return lambda *parts: (make(*parts), False)
    if device.type != "cuda":
        raise ValueError(f"{target}: expected device=cuda, got device={device}")
    return lambda *parts: (make(*parts, device=device), True)


def _fits(bounds: Bounds, solid: Checker, body_to_world: Tensor) -> Tensor:
    """Whether robots could begin at poses: within the scene, and in nothing solid; [S, 4, 4] -> [S] bool."""
    lower, upper = (body_to_world.new_tensor(corner[:2]) for corner in bounds)
    place = body_to_world[:, :2, 3]
    return ((place >= lower) & (place <= upper)).all(1) & ~solid.collides(body_to_world)


def _make_transforms(nodes: DictConfig, robot: Robot, memory: int) -> list[Transform]:
    """New transforms for an env, the innermost first."""
    unknown = set(nodes) - set(TRANSFORMS)
    if unknown:
        raise ValueError(f"transforms: expected {', '.join(TRANSFORMS)}, got {', '.join(sorted(map(str, unknown)))}")
    made = {name: instantiate(nodes[name]) for name in TRANSFORMS if nodes.get(name)}
    if "sprite" in made:
        hidden = ExcludeTransform("depth", "camera_to_world")  # which take more memory than the pixels
        made["sprite"] = Compose(made["sprite"](robot.K), hidden)
    return [*made.values(), *memory_transforms(memory)]


def _start_region(
    motion: FiniteMotion | PlanarMotion, reached: Callable[[Tensor], Tensor], robot: Robot
) -> tuple[Tensor, tuple[list[float], list[float]]]:
    """Where the goal is, positions [N, 3] in metres, and the corners of the box in which the robots' bodies are."""
    states = motion.states()
    places = motion.body_to_world(states)[:, :3, 3]
    lower, upper = places.amin(0) - robot.body.radius, places.amax(0) + robot.body.radius
    return places[reached(states)], (lower.tolist(), upper.tolist())


def build_model(cfg: DictConfig, env: EnvBase) -> ActorValueOperator:
    """Build the actor and critic for an env; its first weights come from PyTorch's global generator."""
    image_shape = env.observation_spec["pixels"].shape[1:]
    return instantiate(cfg.network)(image_shape, env.action_spec).to(env.device)


def make_env(
    overrides: Sequence[str] = (),
    batch_size: Sequence[int] | None = None,
    seed: int = 0,
) -> EnvBase:
    """Make an env from names and paths alone, so that a worker process can.

    Args:
        overrides: in Hydra's grammar, such as ``["scene=kitchen", "scene.path=kitchen.spz"]``.
        batch_size: [B]; None takes ``env.num_envs``.
        seed: of the env's generator.
    """
    cfg = load_config(overrides)
    world = build_world(cfg)
    curriculum = instantiate(cfg.curriculum)(world.plan)
    return world.env(batch_size[0] if batch_size else cfg.env.num_envs, curriculum, seed)
