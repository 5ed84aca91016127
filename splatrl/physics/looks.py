"""What is drawn of a robot and its things: Gaussians of their geoms, or splats in the place of a thing's geoms."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.physics.compose import ROBOT
from splatrl.physics.gaussians import BodyGaussians, gaussians_from_mjcf
from splatrl.physics.optional import needed
from splatrl.physics.robot_world import RobotWorld
from splatrl.scenes.formats import read_gaussians

LARGER = 3.0
"""Ratio of the sizes of a look and the geoms that it replaces above which one of them probably is in another unit."""


def shown_bodies(world: RobotWorld, looks: dict[str, Path]) -> list[BodyGaussians]:
    """Make Gaussians of the bodies of the robot and the things.

    Args:
        world: the robot among its things.
        looks: splat files, by name of thing, that replace the Gaussians of the thing's own geoms.
    """
    prefixes = (ROBOT, *(f"{name}/" for name in world.things))
    found = [body for prefix in prefixes for body in gaussians_from_mjcf(world.model, prefix)]
    for name, path in looks.items():
        shown = BodyGaussians(world.things[name], read_gaussians(path))
        found = [*(body for body in found if not body.body.startswith(f"{name}/")), shown]
    return found


def compare_looks(world: RobotWorld, looks: dict[str, Path], shown: Sequence[BodyGaussians]) -> None:
    """Warn of looks that are much larger or smaller than the geoms that they replace.

    Args:
        world: the robot among its things.
        looks: splat files, by name of thing.
        shown: what ``shown_bodies`` made of them.
    """
    for path, name in {path: name for name, path in reversed(looks.items())}.items():  # copies share a look
        replaced = gaussians_from_mjcf(world.model, f"{name}/")
        if not replaced:
            continue
        look = [body for body in shown if body.body == world.things[name]]
        size, own = _size_of(world.model, look), _size_of(world.model, replaced)
        if not own / LARGER <= size <= LARGER * own:
            warnings.warn(
                f"task.motion.looks.{name}: {path} is {size:.2g} m across, and the geoms that it replaces are "
                f"{own:.2g} m; a look is in metres, in the frame of the thing's first body",
                stacklevel=2,
            )


def _size_of(model: Any, bodies: Sequence[BodyGaussians]) -> float:
    """Return how far across bodies are together, in their default pose, metres: apart from the outermost 2 %."""
    mujoco = needed()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = []
    for name, gaussians in bodies:
        body = data.body(name)
        points.append(gaussians.means.double().numpy() @ body.xmat.reshape(3, 3).T + body.xpos)
    each = np.concatenate(points)
    away = np.linalg.norm(each - np.median(each, axis=0), axis=1)
    return 2.0 * float(np.quantile(away, 0.98))
