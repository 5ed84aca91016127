"""Builds objects from configs: the one place that knows which node builds what."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import current_process
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from torch import Tensor
from torchrl.envs import EnvBase, Transform
from torchrl.modules import ActorValueOperator
from tqdm import tqdm

from splatrl.bodies import Body
from splatrl.collision import NativeChecker, Occupancy
from splatrl.collision.base import Checker
from splatrl.collision.several import SeveralCheckers
from splatrl.configuration import check_config, load_config, place_configs, with_absolute_paths
from splatrl.curriculum import Plan, plan
from splatrl.datasets import Demonstrations, imitate, planner_episodes, read_demonstrations
from splatrl.device import AUTO, KINDS, chosen_device
from splatrl.envs.drawing import Drawing
from splatrl.envs.robot import Robot
from splatrl.envs.sensors import Sensor
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks import Course, NavigationTask, Push, Task
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.rollouts import run_episodes, spread_starts
from splatrl.made_with import made_with
from splatrl.misfits import check_goal, check_height, check_sprite
from splatrl.motions import PhysicsMotion
from splatrl.native.threads import threads_of
from splatrl.physics.survey import survey_terrain
from splatrl.remembered import remembering
from splatrl.renderers.one_scene import OneScene
from splatrl.scenes.scene import Bounds, Scene
from splatrl.several import stacked
from splatrl.training import PPO, Actor, Cloner, Trainer, inputs_of, make_tracker, memory_transforms
from splatrl.values import require_number

BEYOND = 1.0
"""Metres around where robots go in which physics knows what is solid: things roll."""


class _Place(NamedTuple):
    """One scene and what robots do there, before anything is drawn; the fields are those of ``World``."""

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


def build_world(cfg: DictConfig) -> World | Worlds:
    """Build scene, robot, task, collision, drawing and plan from a config, for the device that it names.

    Where the config has several scenes, all of them, for one batch. Paths are planned on the CPU, with the CPU's
    checker.

    Raises:
        ValueError: for a value that is missing, or that one of them refuses.
    """
    check_config(cfg)
    given, device = with_absolute_paths(cfg), chosen_device(cfg.device)
    cfg = cfg.copy()
    cfg.device = str(device)  # the value of ${device} in nodes
    configs = place_configs(cfg)
    places = _build_places(configs, device)
    scenes = [place.scene for place in places]
    drawn = [*scenes, *places[0].task.models]
    renderer = _constructor(configs[0], "renderer", device)(drawn[0] if len(drawn) == 1 else drawn)
    if cfg.renderer.cache is not None and device.type == "cpu":
        renderer = instantiate(cfg.renderer.cache)(renderer)
    transforms = partial(_make_transforms, cfg.transforms, cfg.network.get("memory", 0))
    drawing, robot = instantiate(configs[0].drawing)(renderer), places[0].robot
    sensors = {str(key): instantiate(node) for key, node in (cfg.get("sensors") or {}).items()}
    for place in places:
        check_sprite(drawing, place.robot, place.task)
    drawing = _around(configs[0], drawing)
    made_by = partial(build_world, given)
    if len(places) == 1:
        return places[0].world(drawing, transforms, device, sensors, made_by)
    worlds = tuple(
        place.world(_around(one, instantiate(one.drawing)(OneScene(renderer, number))), transforms, device, sensors)
        for number, (one, place) in enumerate(zip(configs, places, strict=True))
    )
    tasks = [place.task for place in places if isinstance(place.task, torch.nn.Module)]
    if len(tasks) < len(places):
        raise ValueError(f"task: expected a torch module for several scenes, got {type(places[0].task).__name__}")
    checker, task = SeveralCheckers([place.checker for place in places]), stacked(tasks)
    return Worlds(worlds, drawing, checker, robot, task, transforms, device, made_by, sensors)


def _around(cfg: DictConfig, drawing: Drawing) -> Drawing:
    """The drawing inside the one that a transform brings with it, if one does."""
    return instantiate(cfg.around_drawing)(drawing) if cfg.get("around_drawing") else drawing


def build_one_world(cfg: DictConfig) -> World:
    """Build the world of a config with one scene; see ``build_world``.

    Raises:
        ValueError: for several scenes, or what ``build_world`` refuses.
    """
    if (count := len(place_configs(cfg))) > 1:
        raise ValueError(f"scene: expected one scene for this command, got {count}; type scene=<one of them>")
    world = build_world(cfg)
    assert isinstance(world, World)
    return world


def _build_places(configs: Sequence[DictConfig], device: torch.device) -> list[_Place]:
    """Build the scenes of some configs, several side by side and with a progress bar."""
    if len(configs) == 1:
        return [_build_place(configs[0], device)]
    with ThreadPoolExecutor(threads_of(None)) as pool:
        places = pool.map(partial(_build_place, device=device), configs)
        return list(tqdm(places, "scenes", len(configs), unit="scene", dynamic_ncols=True))


def _build_place(cfg: DictConfig, device: torch.device) -> _Place:
    """Build what a config with one scene says of it."""
    scene, robot, task = instantiate(cfg.scene), instantiate(cfg.robot), instantiate(cfg.task)
    check_height(scene.bounds, task)
    region = _start_region(task, robot.body)
    with _key("collision.occupancy"):
        occupancy = instantiate(cfg.collision.occupancy)(scene, *region)
    checker = _constructor(cfg, "collision", device)(occupancy, robot.body)
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
    return _Place(scene, occupancy, checker, robot, task, paths)


def _settle(task: Task, scene: Scene, occupancy: Occupancy, body: Body, antialiased: bool) -> None:
    """Put a robot with physics, and what its task places, on the ground of a scene."""
    motion = task.motion
    assert isinstance(motion, PhysicsMotion)
    if motion.ground == "scene":  # level ground is there from the beginning
        lower, upper = motion.twin.lower.tolist(), motion.twin.upper.tolist()
        with _key("task.motion"):
            reach = body.radius + (BEYOND if motion.pushed else 0.0)
            motion.settle(survey_terrain(scene, occupancy, lower, upper, reach, motion.top, antialiased).terrain)
    if isinstance(task, (Push, Course)):
        with _key("task"):
            task.settle()


def _stands(task: Task, fits: Callable[[Tensor], Tensor], body_to_world: Tensor) -> Tensor:
    """Whether robots with physics could begin at poses: [S, 4, 4] -> [S] bool."""
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
    """Refuse a robot below a scene, or a goal where no robot walks, without building the rest of the world.

    Args:
        cfg: the whole config.
        bounds: of the scene, world, metres.

    Raises:
        ValueError: names the key, what was expected and what came.
    """
    robot, task = instantiate(cfg.robot), instantiate(cfg.task)
    check_height(bounds, task)
    _start_region(task, robot.body)


@contextmanager
def _key(key: str) -> Iterator[None]:
    """Put the key of a config before what its constructor refuses."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error


def _constructor(cfg: DictConfig, group: str, device: torch.device) -> Callable[..., Any]:
    """The constructor in a config group for a kind of device.

    Raises:
        ValueError: if the group has none for it.
    """
    node = cfg[group].get(device.type)
    if node is None:
        others = [kind for kind in KINDS if cfg[group].get(kind) is not None]
        raise ValueError(f"{group}: expected device={' or '.join(others)} for this choice, got device={device}")
    return instantiate(node)


def _fits(bounds: Bounds, solid: Checker, body_to_world: Tensor) -> Tensor:
    """Whether robots could begin at poses: within the scene and not in anything solid; [S, 4, 4] -> [S] bool."""
    lower, upper = (body_to_world.new_tensor(corner[:2]) for corner in bounds)
    place = body_to_world[:, :2, 3]
    return ((place >= lower) & (place <= upper)).all(1) & ~solid.collides(body_to_world)


def _connected(task: NavigationTask, fits: Callable[[Tensor], Tensor], body_to_world: Tensor) -> Tensor:
    """Whether a robot could begin at poses, and reach the goals of a navigation task: [S, 4, 4] -> [S] bool."""
    return fits(body_to_world) & task.geodesics.grounds[0].connected(body_to_world[:, :2, 3])


def _make_transforms(nodes: DictConfig, memory: int) -> list[Transform]:
    """Make new transforms for an env, the innermost first.

    Raises:
        ValueError: for an order that names an unknown transform, or leaves one out.
    """
    order, names = list(nodes.order), [str(name) for name in nodes if name != "order"]
    unknown = [name for name in order if name not in names]
    if unknown:
        raise ValueError(f"transforms.order: expected some of {', '.join(names)}, got {', '.join(map(str, unknown))}")
    left_out = [name for name in names if nodes[name] and name not in order]
    if left_out:
        raise ValueError(f"transforms.order: expected a place for {', '.join(left_out)}, got {order}")
    return [*(instantiate(nodes[name]) for name in order if nodes[name]), *memory_transforms(memory)]


def _start_region(task: Task, body: Body) -> tuple[Tensor, tuple[list[float], list[float]]]:
    """Places that robots can reach, [N, 3] in metres, and the corners of the box that contains their bodies.

    The places are those of the goal states, or of all states if a task has none.
    """
    states = task.motion.states()
    places = task.motion.body_to_world(states)[:, :3, 3]
    reached = task.reached(states)
    if reached is not None:
        check_goal(task, reached)
    lower, upper = places.amin(0) - body.radius, places.amax(0) + body.radius
    return places if reached is None else places[reached], (lower.tolist(), upper.tolist())


def build_model(cfg: DictConfig, env: EnvBase) -> ActorValueOperator:
    """Build the actor and critic for an env; their initial weights come from PyTorch's global generator."""
    image_shape = env.observation_spec["pixels"].shape[1:]
    inputs = inputs_of(cfg.get("inputs") or {}, env.observation_spec)
    given = {"inputs": inputs} if inputs else {}
    if told := inputs_of(cfg.get("critic_inputs") or {}, env.observation_spec, "critic_inputs"):
        given["critic_inputs"] = told
    return instantiate(cfg.network)(image_shape, env.action_spec, **given).to(env.device)


def build_trainer(cfg: DictConfig, world: World | Worlds, folder: Path) -> Trainer:
    """Build the learner and the training loop around it.

    Args:
        cfg: the whole config.
        world: everything that the envs share.
        folder: the run folder.
    """
    curriculum = instantiate(cfg.curriculum)([one.plan for one in world.worlds])
    env = world.env(cfg.env.num_envs, curriculum, cfg.seed)
    torch.manual_seed(cfg.seed)
    model = build_model(cfg, env)
    loss, optim, collector = instantiate(cfg.loss), instantiate(cfg.optim), cfg.collector
    ppo = PPO(
        env, model, loss, optim, collector.frames_per_batch, collector.total_frames, _cuda_graph(collector.cuda_graph)
    )
    starts = spread_starts(world, cfg.logger.num_test_episodes)
    test_env = world.env(min(cfg.env.num_envs, len(starts.state)), seed=cfg.seed)

    def test() -> dict[str, float]:
        test_env.set_seed(cfg.logger.test_seed)  # a test depends on the policy alone, not on the tests before it
        actor, seed = Actor(model, judges=False), cfg.logger.test_seed
        episodes = run_episodes(test_env, actor, starts.state, seed=seed, scene=starts.scene, memory=starts.memory)
        result = {"success": episodes.success.double().mean().item()}
        if world.task.goals_for_success is not None:
            result["goals"] = episodes.goals.double().mean().item()
        if measures := episodes.navigation():
            result["spl"] = measures["spl"]
        return result

    logger, checkpoint, plain = cfg.logger, cfg.checkpoint, cast(dict[str, Any], OmegaConf.to_container(cfg))
    return Trainer(
        ppo,
        folder,
        test,
        logger.test_interval,
        checkpoint.interval,
        make_tracker(logger.backend, folder, logger.exp_name, logger.project, logger.online, plain),
        made_with(cfg, world.digest),
        _teaching(cfg, world, ppo),
    )


def _teaching(cfg: DictConfig, world: World | Worlds, ppo: PPO) -> Callable[[], Iterator[dict[str, float]]] | None:
    """What a policy is taught before it learns from reward; None where there is nothing.

    Raises:
        ValueError: for ``demos`` that are no folder of demonstrations and no number.
    """
    dagger, shown = instantiate(cfg.dagger), []
    if isinstance(cfg.demos, str):
        shown = [read_demonstrations(Path(cfg.demos).expanduser())]
    elif cfg.demos is not None:
        require_number("demos", cfg.demos, 1, 10**6, whole=True)
    elif not dagger.rounds:
        return None

    def teach() -> Iterator[dict[str, float]]:
        cloner = Cloner(ppo.model, instantiate(cfg.cloning))
        episodes = shown or _walked(world, cfg.demos or 0, cfg.seed)
        yield from imitate(ppo, cloner, world, episodes, dagger, worker_seed(cfg.seed, 0))

    return teach


def _walked(world: World | Worlds, episodes: int, seed: int) -> list[Demonstrations]:
    """Episodes of the planner, shared out evenly among the scenes."""
    every = len(world.worlds)
    shares = [(episodes + every - 1 - number) // every for number in range(every)]
    return [planner_episodes(one, share, seed) for one, share in zip(world.worlds, shares, strict=True) if share]


def _cuda_graph(choice: bool | str) -> bool | None:
    """Whether to capture steps; None for auto.

    Raises:
        ValueError: for anything but true, false and auto.
    """
    if choice == AUTO:
        return None
    if not isinstance(choice, bool):
        raise ValueError(f"collector.cuda_graph: expected true, false or auto, got {choice}")
    return choice


def make_env(
    overrides: Sequence[str] = (), batch_size: Sequence[int] | None = None, seed: int | None = None
) -> EnvBase:
    """Make an env from names and paths alone, so that a worker process can do so too.

    Args:
        overrides: overrides in Hydra's grammar, such as ``["scene=kitchen", "scene.path=kitchen.spz"]``.
        batch_size: [B]; None takes ``env.num_envs``.
        seed: seed of the env's generator; None is 0, and in a worker process one that belongs to its number, so that
            workers do not begin alike. ``env_makers`` gives workers seeds that do not depend on processes.

    Raises:
        ValueError: for another shape of the batch, or a config that is refused.
    """
    if batch_size is not None and (len(batch_size) != 1 or batch_size[0] < 1):
        raise ValueError(f"batch_size: expected one number of at least 1, or None, got {list(batch_size)}")
    cfg = load_config(overrides)
    world = build_world(cfg)
    curriculum = instantiate(cfg.curriculum)([one.plan for one in world.worlds])
    place = current_process()._identity  # (2,) in the second process that the main one started
    seed = (worker_seed(0, *place) if place else 0) if seed is None else seed
    env = world.env(cfg.env.num_envs if batch_size is None else batch_size[0], curriculum, seed)
    return env if isinstance(env, StatefulEnv) else StatefulEnv(env)  # whose state TorchRL's collectors keep


def env_makers(
    workers: int, overrides: Sequence[str] = (), batch_size: Sequence[int] | None = None, seed: int = 0
) -> list[Callable[[], EnvBase]]:
    """Constructors of one env for each worker, as TorchRL's collectors and ``ParallelEnv`` take them.

    Example:
        >>> import splatrl
        >>> from torchrl.envs import SerialEnv
        >>> env = SerialEnv(2, splatrl.env_makers(2, ["task=grid"], batch_size=[4]))

    Args:
        workers: number of workers.
        overrides: see ``make_env``.
        batch_size: [B], robots of each worker; None takes ``env.num_envs``.
        seed: each worker's env has a seed that is derived from this one and from its number.

    Raises:
        ValueError: for fewer workers than one, or a seed that is no whole number from 0.
    """
    require_number("workers", workers, 1, whole=True)
    require_number("seed", seed, 0, whole=True)
    return [partial(make_env, overrides, batch_size, worker_seed(seed, worker)) for worker in range(workers)]


def worker_seed(seed: int, *worker: int) -> int:
    """The seed of a worker with a number, or with one for each generation of processes: 63 bits."""
    return int(np.random.SeedSequence(seed, spawn_key=worker).generate_state(1, np.uint64)[0] >> 1)
