"""Checks that scene, robot and goal fit together; errors name the key to change, before anything is trained."""

from torch import Tensor

from splatrl.envs.tasks.base import Task
from splatrl.scenes.scene import Bounds


def check_height(bounds: Bounds, task: Task) -> None:
    """Refuse robots that would move below the scene.

    Args:
        bounds: bounds of the scene, world frame, metres.
        task: the task, whose motion defines where robots are.

    Raises:
        ValueError: names ``robot.height``, or ``scene.bounds`` for robots with physics, whose height is that of their
            MJCF; the lowest height that fits; and what was given.
    """
    lowest, bottom = float(task.motion.body_to_world(task.motion.states())[:, 2, 3].min()), bounds[0][2]
    if lowest >= bottom - 1e-6:
        return
    if task.motion.seconds_per_step is not None:
        raise ValueError(f"scene.bounds: expected a bottom below the robot, at {lowest:.3g} m, got {bottom:.3g} m")
    raise ValueError(
        f"robot.height: expected robots above {bottom:.3g} m, the bottom of scene.bounds, got {lowest:.3g}"
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
    x, y = (f"{least:.3g} to {most:.3g}" for least, most in zip(low, high, strict=True))
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
                f"task.{name}: expected a point in the walkable area, x from {x} and y from {y} m, got {got}; "
                f"type another {landmark}, or wider task.motion.lower and upper"
            )
    raise ValueError(f"task: expected a goal in the walkable area, x from {x} and y from {y} m, found none")
