"""The built-in scene: a backyard in the sun, generated in seconds, with a red egg to be found in it.

``backyard()`` makes the Gaussians, ``backyard_obstacles()`` says what is solid in them, and ``GOAL``,
``ROBOT_HEIGHT`` and ``BOUNDS`` are the task that is set there.
"""

from splatrl.scenes.backyard.layout import BOUNDS, EGG, GOAL, ROBOT_HEIGHT, backyard_obstacles
from splatrl.scenes.backyard.yard import backyard

__all__ = ["BOUNDS", "EGG", "GOAL", "ROBOT_HEIGHT", "backyard", "backyard_obstacles"]
