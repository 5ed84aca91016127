"""One world for MuJoCo: the ground, the scene's boxes, a robot and things that it may move."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch

from splatrl.physics.optional import needed
from splatrl.physics.terrain import Terrain

GROUND, SCENE, ROBOT = "ground", "scene", "robot/"
"""Name of the body of the ground; what boxes are called; prefix of the robot's names. A thing's prefix is its own name
and a slash."""
WORLD = "world"
"""MuJoCo's name of the body that holds the boxes. With hundreds of boxes a substep costs half of what it does with a
body of their own, and the ground has one so that contacts with it are told apart."""
FRICTION = (0.8, 0.005, 0.0001)
"""Of ground and boxes: sliding, torsional and rolling; a contact takes the larger value of its two sides."""


class Composed(NamedTuple):
    """A compiled world.

    Attributes:
        model: the ``MjModel``.
        robot: name of the robot's first body.
        things: name of the first body of each thing, by the thing's name.
    """

    model: Any
    robot: str
    things: dict[str, str]


def compose(robot: Any, terrain: Terrain, things: Mapping[str, Any] | None = None) -> Composed:
    """Put a robot and things into a scene.

    Options such as the time step, the integrator and gravity are the robot's. For each thing, and for the boxes, a
    contact sensor ``touch/<name>`` says in each substep how many contacts the robot has with it.

    Args:
        robot: an ``MjSpec`` with one body at the top, and no ground.
        terrain: the scene.
        things: an ``MjSpec`` with one body at the top for each, by name.

    Raises:
        ValueError: for a robot or thing with another number of bodies at the top, or with geoms that no body holds.
    """
    mujoco = needed()
    world = mujoco.MjSpec()
    _copy_options(robot, world)
    ground = world.worldbody.add_body(name=GROUND)
    normal, offset = terrain.plane[:3], float(terrain.plane[3])
    ground.add_geom(
        name=GROUND,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        pos=(normal * offset).tolist(),
        quat=_upright(normal),
        friction=FRICTION,
    )
    for row in terrain.boxes.tolist():
        world.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=row[:3], size=row[3:], friction=FRICTION)
    first = _attach(world, robot, ROBOT, "robot")
    tops = {}
    for name, thing in (things or {}).items():
        _copy_options(robot, thing)
        tops[name] = _attach(world, thing, f"{name}/", name)
    if len(terrain.boxes):
        _touch(mujoco, world, SCENE, first, WORLD)
    for name, top in tops.items():
        _touch(mujoco, world, name, first, top)
    try:
        return Composed(world.compile(), first, tops)
    except ValueError as error:
        raise ValueError(f"robot: expected MJCF that fits into a scene, got {' '.join(str(error).split())}") from error


def _attach(world: Any, spec: Any, prefix: str, name: str) -> str:
    """Attach a spec to the world, and return the full name of its first body."""
    bodies, loose = list(spec.worldbody.bodies), list(spec.worldbody.geoms)
    if loose:
        raise ValueError(
            f"{name}: geom {loose[0].name or 0!r}: expected one in a body; the ground comes from the scene"
        )
    if len(bodies) != 1:
        raise ValueError(f"{name}: expected one body in <worldbody>, got {len(bodies)}")
    bodies[0].name = bodies[0].name or "body"
    world.attach(spec, prefix=prefix, frame=world.worldbody.add_frame())
    return f"{prefix}{bodies[0].name}" if not bodies[0].name.startswith(prefix) else str(bodies[0].name)


def _touch(mujoco: Any, world: Any, name: str, robot: str, other: str) -> None:
    """Sense contacts of the robot, all its links included, with another body and what hangs on it, or with boxes."""
    world.add_sensor(
        name=f"touch/{name}",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=robot,
        reftype=mujoco.mjtObj.mjOBJ_BODY if other == WORLD else mujoco.mjtObj.mjOBJ_XBODY,
        refname=other,
        intprm=[1, 0, 1],  # the number found; no reduction; one slot
    )


def _copy_options(source: Any, target: Any) -> None:
    """Give a spec the physical options of another, so that nothing is left to disagree about."""
    for name in dir(source.option):
        if not name.startswith("_"):
            setattr(target.option, name, getattr(source.option, name))


def _upright(normal: torch.Tensor) -> list[float]:
    """The quaternion wxyz that turns z to a normal by the shortest way."""
    x, y, z = normal.tolist()
    w = math.sqrt((1.0 + z) / 2.0)
    return [w, -y / (2.0 * w), x / (2.0 * w), 0.0]
