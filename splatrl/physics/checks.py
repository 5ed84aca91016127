"""Checks that a robot and its things work, before anyone learns with them."""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from splatrl.geometry import quat_yaws, wrapped
from splatrl.physics.gaussians import SHOWN_GROUPS
from splatrl.physics.robot_world import RobotWorld
from splatrl.physics.stepping import Physics
from splatrl.physics.things import Things

LEAST_AHEAD = 0.1
"""Smallest horizontal part of the unit vector that points ahead, for which a standing robot has a heading."""
RESTING, SETTLED = 0.2, 0.02
"""Seconds for which a thing must rest where its file puts it, and metres by which its height may change meanwhile."""
APART = 1e3
"""Distance between things, and from the robot, where it is checked that they rest, metres."""

STARTING, TURNING, TURNED = 0.2, 0.4, 0.1
"""Seconds in which a robot reaches its turn rate, then seconds and least radians over which its turn is measured."""
OFF_AXLE = 0.05
"""Largest distance from a robot's first body to the point about which it turns, metres, of which nobody is warned."""


def require_multiple(held: float, timestep: float) -> int:
    """Return how many substeps of a duration make a time step, both in seconds; refuse a part of one."""
    substeps = held / timestep
    if round(substeps) < 1 or abs(substeps - round(substeps)) > 1e-6:
        raise ValueError(
            f"task.motion.time_step: expected a multiple of the robot's timestep, {timestep:g} s, got {held:g}"
        )
    return round(substeps)


def require_heading(path: Path, orientation: Tensor) -> None:
    """Refuse a robot whose first body's x axis points up or down where it stands, so that it has no heading.

    Args:
        path: its MJCF file.
        orientation: [4] of its first body, a unit quaternion wxyz.
    """
    w, x, y, z = orientation.tolist()
    up = 2.0 * (x * z - w * y)
    if math.sqrt(max(0.0, 1.0 - up * up)) < LEAST_AHEAD:
        raise ValueError(
            f"{path}: expected a first body whose x axis points ahead, got one that points "
            f"{'up' if up > 0 else 'down'}; put the turned parts into a body within it"
        )


def require_sound(world: RobotWorld, physics: Physics) -> None:
    """Refuse a robot whose physics fails within a step with the lowest, highest or alternating controls."""
    low, high = world.control_limits()
    every_other = torch.where(torch.arange(len(low)) % 2 == 0, low, high)
    number = torch.arange(len(physics.models)).repeat_interleave(3)
    home = physics.layout.with_model(physics.state_of(world.qpos, world.act).expand(len(number), -1), number)
    controls = torch.stack([low, high, every_other]).repeat(len(physics.models), 1)
    if not physics.step(home, controls).sound.all():
        raise ValueError(
            f"{world.path}: expected physics that can carry out any action, got one that fails within the first; "
            "lower the timestep or the actuators' gains (kv, kp), or add armature to their joints"
        )


def require_shown(things: Things, shown: Sequence[str]) -> None:
    """Refuse things that are not drawn, given the names of the bodies that are."""
    for name, path in things.paths.items():
        if not any(body.startswith(f"{name}/") for body in shown):
            raise ValueError(
                f"task.motion.things: {path}: expected a thing with geoms that are drawn (group below "
                f"{SHOWN_GROUPS}, visible rgba), got none; show one, or give a splat in task.motion.looks.{name}"
            )


def require_rest(world: RobotWorld, physics: Physics, things: Things, held: float) -> None:
    """Refuse things with a free joint that do not rest on level ground.

    Args:
        world: the robot among the things, on level ground.
        physics: its physics.
        things: their files.
        held: duration of a step of the physics, seconds.
    """
    before, free = _apart(world, physics, things)
    if not free:
        return
    state, still = before, torch.from_numpy(world.ctrl).unsqueeze(0)
    for _ in range(math.ceil(RESTING / held)):
        state = physics.step(state, still).state
    for name, columns in free.items():
        risen = float((state - before)[0, columns][2])
        if not abs(risen) <= SETTLED:  # also true for NaN
            raise ValueError(
                f"task.motion.things: {things.paths[name]}: expected a thing that rests on z = 0 where its "
                f"file puts it, got one that {'rises' if risen > 0 else 'falls'} by {100 * abs(risen):.3g} cm "
                f"within {RESTING:g} s; set the pos of its body, and let its geoms touch (contype, conaffinity)"
            )


def compare_axle(world: RobotWorld, physics: Physics, things: Things, held: float) -> None:
    """Warn of a robot with the servos forward and turn that does not turn about its first body, as paths expect it to.

    Args:
        world: the robot among the things, on level ground.
        physics: its physics.
        things: their files.
        held: duration of a step of the physics, seconds.
    """
    state, _ = _apart(world, physics, things)
    turn = world.control_limits()[1:] * torch.tensor([0.0, 1.0])
    poses = []
    for seconds in (STARTING, TURNING):
        for _ in range(math.ceil(seconds / held)):
            state = physics.step(state, turn).state
        poses.append((state[0, physics.layout.position][:2], quat_yaws(state[0, physics.layout.orientation])))
    (start, before), (end, after) = poses
    angle = float(wrapped(after - before))
    if not abs(angle) > TURNED:
        return
    x, y = (end - start).tolist()
    away = 0.5 * math.hypot(x, y) / abs(math.sin(0.5 * angle))  # of a chord's ends from the middle of its circle
    if away > OFF_AXLE:
        warnings.warn(
            f"{world.path}: expected a robot that turns about the origin of its first body, as paths take it to, got "
            f"one that turns about a point {away:.2g} m from it, and so may touch the walls of narrow lanes",
            stacklevel=2,
        )


def _apart(world: RobotWorld, physics: Physics, things: Things) -> tuple[Tensor, dict[str, slice]]:
    """Return the state at rest with all movable things far from the robot, [1, n], and their columns by name."""
    joints = {name: world.free_joint(name) for name in things.paths}
    free = {name: physics.layout.free_joint(address) for name, address in joints.items() if address is not None}
    state = physics.state_of(world.qpos, world.act).unsqueeze(0)
    for number, columns in enumerate(free.values()):
        state[:, columns][:, 0] += APART * (number + 1)
    return state, free
