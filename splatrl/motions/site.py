"""The scene in which a motion or a task settles, and where episodes may begin in it."""

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from splatrl.bodies import Body
from splatrl.collision.base import Checker
from splatrl.collision.occupancy import Occupancy
from splatrl.scenes.scene import Scene

Fits = Callable[[Tensor], Tensor]
"""Tells whether episodes may begin in poses: body_to_world [S, 4, 4] float32 -> [S] bool."""


class Site(NamedTuple):
    """One scene, on the CPU, before paths are planned in it.

    Attributes:
        scene: Gaussians and bounds.
        occupancy: the solid voxels.
        checker: finds what the robot's body touches; paths are planned with it.
        body: the robot's body.
        antialiased: whether the scene is rendered with antialiasing.
        leeway: how far beyond the motion's bounds robots may go before they count as outside, metres.
        varies: whether episodes draw from what the motion varies, such as models of the physics.
        repeats: number of times that a robot carries out each action.
    """

    scene: Scene
    occupancy: Occupancy
    checker: Checker
    body: Body
    antialiased: bool
    leeway: float = 0.0
    varies: bool = True
    repeats: int = 1


def narrowed(fits: Fits, further: Fits) -> Fits:
    """Return a condition that requires another one too, which is tested only in poses that ``fits`` allows."""

    def both(body_to_world: Tensor) -> Tensor:
        allowed = fits(body_to_world)
        rows = allowed.nonzero().squeeze(1)
        allowed[rows] = further(body_to_world[rows])
        return allowed

    return both
