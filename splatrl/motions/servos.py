"""Velocity servos called forward and turn, which give a robot with physics the actions and speeds of its twin."""

import math
from collections.abc import Sequence

from splatrl.physics.robot_world import RobotWorld

FORWARD, TURN = "forward", "turn"
"""Names of velocity servos in metres and radians per second; with these two alone, a robot can follow shortest
paths."""


def driven(world: RobotWorld) -> bool:
    """Return whether a robot's only actuators are the two servos, in this order.

    Raises:
        ValueError: for turn before forward.
    """
    servos = world.velocity_servos()
    if servos == [TURN, FORWARD]:
        raise ValueError(f"{world.path}: expected the actuator {FORWARD!r} before {TURN!r}, got it after")
    return servos == [FORWARD, TURN]


def twin_speeds(
    world: RobotWorld, linear: Sequence[float] | None, angular_deg: float | None
) -> tuple[Sequence[float], float]:
    """Return the speeds of a robot's kinematic twin: those given, or else the limits of the robot's servos.

    Args:
        world: the robot's world.
        linear: lowest and highest speed, metres per second; None takes the limits of the servo forward.
        angular_deg: highest angular velocity, degrees per second; None takes that of the servo turn.

    Raises:
        ValueError: for a speed that is not given to a robot without these servos; names its key.
    """
    lacking = [key for key, given in (("linear", linear), ("angular_deg", angular_deg)) if given is None]
    if lacking and not driven(world):
        raise ValueError(
            f"task.motion.{lacking[0]}: expected a value, got none, which needs a robot whose only actuators are "
            f"<velocity> servos called {FORWARD!r} and {TURN!r}; {world.path} has others, with which "
            "robots cannot take part in pointnav and imagenav either"
        )
    limits = world.model.actuator_ctrlrange.tolist()
    return limits[0] if linear is None else linear, math.degrees(limits[1][1]) if angular_deg is None else angular_deg
