"""Composes one MuJoCo world from the ground, the scene's boxes, a robot and things that it may move."""

import itertools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch

from splatrl.physics.kinematics import rotated
from splatrl.physics.optional import needed, without_warnings
from splatrl.physics.standing import on_ground
from splatrl.physics.terrain import Terrain

GROUND, SCENE, ROBOT = "ground", "scene", "robot/"
"""Name of the ground's body; name of the boxes' contact sensor; prefix of the robot's names. A thing's prefix is its
own name and a slash."""
WORLD = "world"
"""MuJoCo's name of the world body, which holds the boxes: with hundreds of them, a substep costs half of what it does
when the boxes have a body of their own. The ground has its own body, so that contacts with it can be told apart."""
RESERVED = (GROUND, "robot", SCENE, WORLD)
"""Names that no thing may have."""
FRICTION = (0.8, 0.005, 0.0001)
"""Sliding, torsional and rolling friction of ground and boxes; a contact takes the larger value of its two sides."""


class Composed(NamedTuple):
    """A compiled world.

    Attributes:
        model: the ``MjModel``.
        robot: name of the robot's first body.
        things: for each thing's name, the name of its first body.
    """

    model: Any
    robot: str
    things: dict[str, str]


@without_warnings()
def compose(robot: Any, terrain: Terrain, things: Mapping[str, Any] | None = None) -> Composed:
    """Put a robot and things into a scene.

    The robot stays where its file places it; things are placed relative to the ground as their files place them
    relative to z = 0. Bodies without a name get one. Options such as the time step, the integrator and gravity are the
    robot's. For each thing, and for the boxes, a contact sensor ``touch/<name>`` counts the robot's contacts with it in
    each substep.

    Args:
        robot: an ``MjSpec`` with one top-level body, and no ground.
        terrain: the scene's ground and boxes.
        things: an ``MjSpec`` with one top-level body for each thing, by name.

    Raises:
        ValueError: for a robot or thing without exactly one top-level body, or with geoms outside any body.
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
        tops[name] = _attach(world, thing, f"{name}/", name, terrain)
    if len(terrain.boxes):
        _touch(mujoco, world, SCENE, first, WORLD)
    for name, top in tops.items():
        _touch(mujoco, world, name, first, top)
    try:
        return Composed(world.compile(), first, tops)
    except ValueError as error:
        raise ValueError(
            f"robot: expected MJCF that compiles together with the scene, got {' '.join(str(error).split())}"
        ) from error


def _attach(world: Any, spec: Any, prefix: str, name: str, terrain: Terrain | None = None) -> str:
    """Attach a spec to the world, put it onto a terrain if one is given, and return the full name of its first body."""
    bodies, loose = list(spec.worldbody.bodies), list(spec.worldbody.geoms)
    if loose:
        raise ValueError(
            f"{name}: geom {loose[0].name or 0!r}: expected a geom inside a body, got one in <worldbody>; "
            "the ground comes from the scene, so pass the file of the model alone, without the scene around it"
        )
    if len(bodies) != 1:
        raise ValueError(f"{name}: expected one body in <worldbody>, got {len(bodies)}")
    _name_bodies(spec)
    first = f"{prefix}{bodies[0].name}"
    place, turn = ([0.0] * 3, [1.0, 0.0, 0.0, 0.0]) if terrain is None else _lift(spec, terrain)
    world.attach(spec, prefix=prefix, frame=world.worldbody.add_frame(pos=place, quat=turn))
    return first


def _name_bodies(spec: Any) -> None:
    """Name the bodies of a spec that have no name, since bodies are found by their names."""
    taken = {body.name for body in spec.bodies}
    names = itertools.chain(["body"], (f"body{number}" for number in itertools.count(2)))
    unused = (name for name in names if name not in taken)
    for body in spec.bodies:
        body.name = body.name or next(unused)


def _lift(spec: Any, terrain: Terrain) -> tuple[list[float], list[float]]:
    """Return position and quaternion wxyz of the frame that moves a thing's first body from z = 0 onto a terrain."""
    place = torch.from_numpy(spec.copy().compile().body_pos[1].copy())
    straight = torch.cat([place, place.new_tensor([1.0, 0.0, 0.0, 0.0])])
    pose = on_ground(torch.cat([place[:2], place.new_zeros(1)]).unsqueeze(0), straight, terrain).squeeze(0)
    return (pose[:3] - rotated(pose[3:], place)).tolist(), pose[3:].tolist()


def _touch(mujoco: Any, world: Any, name: str, robot: str, other: str) -> None:
    """Add a sensor of contacts between the robot with all its links and another body's subtree, or the boxes."""
    world.add_sensor(
        name=f"touch/{name}",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_XBODY,
        objname=robot,
        reftype=mujoco.mjtObj.mjOBJ_BODY if other == WORLD else mujoco.mjtObj.mjOBJ_XBODY,
        refname=other,
        intprm=[1, 0, 1],  # report the number of contacts; no reduction; one slot
    )


def _copy_options(source: Any, target: Any) -> None:
    """Give a spec the physics options of another, so that the two cannot conflict."""
    for name in dir(source.option):
        if not name.startswith("_"):
            setattr(target.option, name, getattr(source.option, name))


def _upright(normal: torch.Tensor) -> list[float]:
    """Return the quaternion wxyz of the shortest rotation from z to a normal."""
    x, y, z = normal.tolist()
    w = math.sqrt((1.0 + z) / 2.0)
    return [w, -y / (2.0 * w), x / (2.0 * w), 0.0]
