"""Builds worlds: everything that the envs of a config share."""

import math
from functools import partial

import torch
from omegaconf import DictConfig
from torchrl.envs import Transform

from splatrl.building.instantiation import instantiate
from splatrl.building.places import build_places, constructor
from splatrl.collision.several import SeveralCheckers
from splatrl.configuration import check_config, check_files, place_configs, place_names, with_absolute_paths
from splatrl.device import chosen_device
from splatrl.envs.drawing import Drawing
from splatrl.envs.sensors.base import check_sensors
from splatrl.envs.transforms import FrameSkip
from splatrl.envs.world import World, Worlds
from splatrl.per_scene import stacked
from splatrl.renderers.one_scene import OneScene
from splatrl.training import memory_transforms


def build_world(cfg: DictConfig) -> World | Worlds:
    """Build scene, robot, task, collision checker, drawing and plan from a config, on the device that it names.

    If the config has several scenes, all of them are built, for one batch. Paths are planned on the CPU, with the CPU's
    checker.

    Raises:
        ValueError: for a value that is missing, or that a constructor refuses.
    """
    check_config(cfg)
    check_files(cfg)
    given, device = with_absolute_paths(cfg).copy(), chosen_device(cfg.device)
    if cfg.device != str(device):
        cfg = cfg.copy()
        cfg.device = str(device)  # the value of ${device} in nodes
    configs = place_configs(cfg)
    transforms = partial(_make_transforms, cfg.transforms, cfg.network.get("memory", 0))
    sensors = {str(key): instantiate(node) for key, node in (cfg.get("sensors") or {}).items()}
    if sensors:
        check_sensors(sensors, instantiate(configs[0].task))  # building takes long
    places = build_places(configs, device, place_names(cfg), repeats_of(cfg))
    scenes = [place.scene for place in places]
    drawn = [*scenes, *places[0].task.models]
    renderer = constructor(configs[0], "renderer", device)(drawn[0] if len(drawn) == 1 else drawn)
    if cfg.renderer.cache is not None:
        renderer = constructor(cfg, "renderer.cache", device)(renderer)
    drawing, robot = instantiate(configs[0].drawing)(renderer), places[0].robot
    for place in places:
        place.task.check_picture(drawing, place.robot)
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
        raise ValueError(f"task: expected a torch module, as several scenes need, got {type(places[0].task).__name__}")
    checker, task = SeveralCheckers([place.checker for place in places]), stacked(tasks)
    return Worlds(worlds, drawing, checker, robot, task, transforms, device, made_by, sensors)


def _around(cfg: DictConfig, drawing: Drawing) -> Drawing:
    """Wrap the drawing in the one that a transform brings with it, if there is one."""
    return instantiate(cfg.around_drawing)(drawing) if cfg.get("around_drawing") else drawing


def repeats_of(cfg: DictConfig) -> int:
    """Return the number of times that a robot carries out each action under the transforms of a config."""
    made = _make_transforms(cfg.transforms, cfg.network.get("memory", 0))
    return math.prod(one.steps for one in made if isinstance(one, FrameSkip))


def build_one_world(cfg: DictConfig) -> World:
    """Build the world of a config with one scene; see ``build_world``.

    Raises:
        ValueError: for several scenes, or anything that ``build_world`` refuses.
    """
    if (count := len(place_configs(cfg))) > 1:
        raise ValueError(f"scene: expected one scene for this command, got {count}; type scene=<one of them>")
    world = build_world(cfg)
    assert isinstance(world, World)
    return world


def _make_transforms(nodes: DictConfig, memory: int) -> list[Transform]:
    """Make new transforms for an env, from the innermost outwards.

    Raises:
        ValueError: for an order that names an unknown transform, repeats one, or omits one.
    """
    order, names = list(nodes.order), [str(name) for name in nodes if name != "order"]
    unknown = [name for name in order if name not in names]
    if unknown:
        raise ValueError(
            f"transforms.order: expected only names from {', '.join(names)}, got {', '.join(map(str, unknown))}"
        )
    if repeated := [name for name in names if order.count(name) > 1]:
        raise ValueError(f"transforms.order: expected each name once, got {', '.join(repeated)} more than once")
    left_out = [name for name in names if nodes[name] and name not in order]
    if left_out:
        raise ValueError(f"transforms.order: expected an entry for {', '.join(left_out)}, got {order}")
    return [*(instantiate(nodes[name]) for name in order if nodes[name]), *memory_transforms(memory)]
