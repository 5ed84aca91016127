"""Checks that scene, robot and goal fit together; errors name the key to change, before anything is trained."""

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchrl.envs import Transform

from splatrl.collision.base import Checker
from splatrl.collision.columns import cells_across
from splatrl.collision.voxel_grid import widened
from splatrl.collision.voxels import Voxels
from splatrl.curriculum import Plan
from splatrl.envs.sensors import GoalSensor, Sensor
from splatrl.envs.tasks.base import Task
from splatrl.envs.transforms import FrameStack
from splatrl.motions import LatticeMotion, OrbitMotion
from splatrl.scenes.scene import Bounds, Scene

CUT_OFF = 0.1
"""Fraction of the free poses that may be cut off from the goal without a warning."""
HOLE = 0.3
"""Maximum distance from a place to the floor below it, across, metres: captured floors have holes."""
LOW = 1.0
"""Maximum height of robots whose floor is expected to have been captured, metres."""


def check_height(bounds: Bounds, task: Task) -> None:
    """Refuse robots that would move below the scene, or at a fixed height far above it.

    Far is more than its longest side: a floor may be all that was captured. Robots whose height varies, because they
    orbit an object or fly, may be anywhere above it.

    Args:
        bounds: bounds of the scene, world frame, metres.
        task: the task, whose motion defines where robots are.

    Raises:
        ValueError: names ``robot.height``, or ``scene.bounds`` for robots with physics, whose height is that of their
            MJCF; the limit of what fits; and what was given.
    """
    lowest = float(task.motion.body_to_world(task.motion.states())[:, 2, 3].min())
    lower, upper = bounds
    bottom, top, longest = lower[2], upper[2], max(b - a for a, b in zip(lower, upper, strict=True))
    if task.motion.height is not None and lowest > top + longest:
        raise ValueError(
            f"robot.height: expected robots less than {longest:.3g} m above the top of scene.bounds, {top:.3g} m, "
            f"got {lowest:.3g}"
        )
    if lowest >= bottom - 1e-6:
        return
    if task.motion.height is None:
        raise ValueError(f"scene.bounds: expected a bottom below the robot, at {lowest:.3g} m, got {bottom:.3g} m")
    raise ValueError(
        f"robot.height: expected robots above {bottom:.3g} m, the bottom of scene.bounds, got {lowest:.3g}"
    )


def warn_of_uncaptured(scene: Scene, task: Task, solid: Checker) -> None:
    """Warn of robots that could move where nothing was captured, since nothing would stop them there or be seen.

    Robots that orbit an object, which they always see, may be there.

    Args:
        scene: the scene; a tenth of their longest side is tolerated beyond its Gaussians and its bounds.
        task: the task, whose motion defines where robots are.
        solid: tells where the body does not fit, such as behind a closed wall, where robots never are.
    """
    motion = task.motion
    if isinstance(motion, OrbitMotion) or not _beyond(widened(scene.bounds), motion.region()).any():
        return
    extent = scene.extent
    poses = motion.body_to_world(motion.states())
    poses = poses[_beyond(widened(scene.bounds, extent), poses[:, :3, 3])]
    places = poses[~solid.collides(poses)][:, :2, 3]
    if len(places):
        free = _ranges(places.amin(0).tolist(), places.amax(0).tolist())
        warnings.warn(
            f"{scene.name}: robots may go where nothing was captured, {free}, beyond {_ranges(*extent)}; narrower "
            "task.motion.lower and upper keep them out",
            stacklevel=2,
        )


def warn_of_no_floor(scene: Scene, paths: Plan, occupancy: Voxels) -> None:
    """Warn if nothing solid is below the goal, or below most starts, as beside a room that was captured from inside.

    Left out are robots that orbit an object or whose height varies, robots at more than ``LOW``, since films at eye
    level show little floor, and scenes without any floor below the robots, such as cropped ones.

    Args:
        scene: the scene.
        paths: free poses and shortest paths.
        occupancy: what is solid in the scene.
    """
    motion = paths.motion
    if motion.height is None or motion.height > LOW or isinstance(motion, OrbitMotion):
        return
    places = motion.planar(paths.states)[:, :2].double().cpu().numpy()
    floor = _above_floor(places, motion.height, occupancy)
    free, starts = paths.free.cpu().numpy(), floor[paths.start_rows.cpu().numpy()]
    goal = free & (paths.distance == 0).cpu().numpy() & (paths.field is not None)
    missing = None
    if goal.any() and not floor[goal].any():
        missing = "the goal; type another landmarks.goal"
    elif (lacking := int((~starts).sum())) > 0.5 * len(starts):
        missing = f"{lacking:,} of {len(starts):,} starts; narrower task.motion.lower and upper leave them out"
    if missing is not None and floor[free].any():
        warnings.warn(f"{scene.name}: nothing solid, such as a floor, is below {missing}", stacklevel=2)


def _above_floor(places: NDArray[np.float64], height: float, occupancy: Voxels) -> NDArray[np.bool_]:
    """Return whether anything solid is below places [N, 2] at a height, or as far as ``HOLE`` beside it: [N] bool."""
    edge, reach = occupancy.resolution, math.ceil(HOLE / occupancy.resolution)
    layers = max(0, math.floor(height / edge) - occupancy.origin_key[2])
    below = np.pad(occupancy.occupied[:, :, :layers].any(2), reach + 1)
    first_key = [key - reach - 1 for key in occupancy.origin_key[:2]]
    return cells_across(below, first_key, edge, places) <= reach


def warn_of_cut_off(scene: Scene, paths: Plan) -> None:
    """Warn if no path leads to the goal from more than a tenth of the free poses, such as those in another room.

    Robots that orbit an object are left out: things that stand on their circle cut it off as a matter of course.

    Args:
        scene: the scene.
        paths: free poses and shortest paths.
    """
    cut_off, free = int(paths.cut_off.sum()), int(paths.free.sum())
    if cut_off > CUT_OFF * free and not isinstance(paths.motion, OrbitMotion):
        finer = f"task.motion.step={0.5 * paths.motion.step:g} or " if isinstance(paths.motion, LatticeMotion) else ""
        body = f"{finer}a narrower robot.body may pass, or narrower task.motion.lower and upper leave them out"
        way_out = body if paths.moves.repeats == 1 else "fewer transforms.skip.steps may lead out of there"
        warnings.warn(
            f"{scene.name}: {cut_off:,} of {free:,} free poses cannot reach the goal, and episodes never begin there; "
            f"{way_out}",
            stacklevel=2,
        )


def warn_of_far_starts(scene: Scene, paths: Plan) -> None:
    """Warn of starts that are farther from the goal than an episode is long; see ``Plan.in_reach``.

    Args:
        scene: the scene.
        paths: shortest paths.

    Raises:
        ValueError: if all starts are.
    """
    count = len(paths.start_rows)
    far = count - len(paths.in_reach.start_rows)
    if far == count:
        nearest = int(paths.distance[paths.start_rows].min())
        raise ValueError(
            f"task.max_steps: expected at least {nearest}, the steps from the nearest start to the goal, "
            f"got {paths.max_steps}"
        )
    if far:
        warnings.warn(
            f"{scene.name}: {far:,} of {count:,} starts are farther from the goal than "
            f"task.max_steps={paths.max_steps}: training leaves them out, and evaluation counts them as failures",
            stacklevel=2,
        )


def _beyond(box: Sequence[Sequence[float]], places: Tensor) -> Tensor:
    """Return which places lie beside a box: [N, 3] -> [N] bool."""
    lower, upper = torch.tensor(box)[:, :2]
    return ((places[:, :2] < lower) | (places[:, :2] > upper)).any(1)


def _ranges(lower: Sequence[float], upper: Sequence[float]) -> str:
    """Return the x and y of a box in words."""
    x, y = (f"{least:.3g} to {most:.3g}" for least, most in zip(lower[:2], upper[:2], strict=True))
    return f"x from {x} and y from {y} m"


def warn_of_unknown_goal(task: Task, sensors: Mapping[str, Sensor], read: Sequence[str]) -> None:
    """Warn if nothing tells a policy where the goal of its episode is.

    Args:
        task: the task; tasks without a goal for each episode need not tell it.
        sensors: the robots' sensors, by key.
        read: keys of the observations that the policy reads.
    """
    if task.goal_radius is None or any(isinstance(sensors.get(key), GoalSensor) for key in read):
        return
    warnings.warn(
        f"sensors: the policy cannot know its goal, since it reads {', '.join(read)} and neither pointgoal nor "
        "imagegoal; add one of them to sensors=[...]",
        stacklevel=2,
    )


def check_stack(transforms: Sequence[Transform], read: Sequence[str]) -> None:
    """Refuse stacks of earlier views that a policy does not read, so that it would have no memory.

    Args:
        transforms: the transforms of an env.
        read: keys of the observations that the policy reads.

    Raises:
        ValueError: if it reads nothing that is stacked.
    """
    for one in transforms:
        if isinstance(one, FrameStack) and not set(one.in_keys) & set(read):
            raise ValueError(
                f"memory=stack: expected a policy that reads what is stacked, {', '.join(map(str, one.in_keys))}, got "
                f"one that reads {', '.join(read)}; type memory=gru, or add rgb to sensors=[...]"
            )


def check_goal(task: Task, reached: Tensor) -> None:
    """Refuse a goal that no pose is close enough to reach.

    Args:
        task: the task, which defines where robots are and what they have to reach.
        reached: [S] bool, whether the states of its motion are at the goal.

    Raises:
        ValueError: names the goal's key, what was given, and, if it lies outside, the region where robots walk.
    """
    if reached.any():
        return
    places = task.motion.planar(task.motion.states())[:, :2]
    low, high = places.amin(0), places.amax(0)
    area = _ranges(low.tolist(), high.tolist())
    for name, landmark in (("goal", "landmarks.goal"), ("place", "landmarks.object")):
        value = getattr(task, name, None)
        if isinstance(value, Tensor):
            got = [round(number, 3) for number in value[:2].tolist()]
            if bool(((value[:2] >= low) & (value[:2] <= high)).all()):
                raise ValueError(
                    f"task.{name}: expected a pose that robots can reach, got {got}; "
                    f"type another {landmark}, or another motion@task.motion"
                )
            raise ValueError(
                f"task.{name}: expected a point in the walkable area, {area}, got {got}; "
                f"type another {landmark}, or wider task.motion.lower and upper"
            )
    raise ValueError(f"task: expected a goal in the walkable area, {area}, found none")
