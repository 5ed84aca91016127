"""The goals of an episode on the page: drawn over the splats, in words, and as the picture of an image goal."""

import math
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from splatrl.envs.sensors.goals import ImageGoal
from splatrl.envs.tasks.base import Mark
from splatrl.envs.world import World
from splatrl.evaluation.figure_style import mark_styles
from splatrl.geometry import yaw_quat
from splatrl.viewer.robot import FACES, enlarged, rgb, wedge

if TYPE_CHECKING:
    import viser

AHEAD_DEG = 5.0
"""Largest angle, in degrees, at which a goal counts as straight ahead."""


class GoalsShown:
    """Marks for the goals of a task: an arrow, or a ball for a goal without a direction.

    Args:
        server: server of the page, whose panel also shows the picture of an image goal.
        name: scene node that holds the marks, such as ``/robot/goals``.
        world: scene and task.
        common: whether to show goals that all episodes have in common, too, as on a page without handles for them.
    """

    def __init__(self, server: "viser.ViserServer", name: str, world: World, common: bool = False):
        self.server, self.name, self.world = server, name, world
        self.shown = common or bool(world.task.memory_spec)
        self.nodes: list[Any] = []
        blank = torch.zeros(world.robot.image_height, world.robot.image_width, 3, dtype=torch.uint8)
        told = ImageGoal.KEY in world.told
        self.image = server.gui.add_image(enlarged(blank), label="view at the goal") if told else None

    def show(self, now: TensorDictBase) -> str:
        """Show the goals in one robot's observation [1]; return their distances and directions in words."""
        task = self.world.task
        if not self.shown:
            return ""
        marks = task.marks({key: now[key][0].cpu() for key in task.memory_spec} or None)
        state = now["state"].cpu()
        height = float(task.motion.body_to_world(state)[0, 2, 3])
        with self.server.atomic():
            for node in self.nodes:
                node.remove()
            self.nodes = [self._drawn(number, mark, marks, height) for number, mark in enumerate(marks)]
            if self.image is not None:
                self.image.image = enlarged(now[ImageGoal.KEY][0])
        return " · ".join(whereabouts(task.motion.planar(state)[0], mark) for mark in marks)

    def _drawn(self, number: int, mark: Mark, marks: list[Mark], height: float) -> Any:
        """Draw a mark and its name over the splats."""
        scene, name, corners = self.server.scene, f"{self.name}/{number}", wedge(self.world.robot)
        x, y, yaw = mark.planar.tolist()
        color, place = rgb(mark_styles(marks)[mark.name][0]), (x, y, height)
        if math.isnan(yaw):
            node: Any = scene.add_icosphere(name, 0.5 * float(corners.max()), color, position=place)
        else:
            turned = yaw_quat(yaw)
            node = scene.add_mesh_simple(name, corners, FACES, color=color, side="double", wxyz=turned, position=place)
        scene.add_label(f"{name}/name", mark.name)
        return node


def whereabouts(planar: Tensor, mark: Mark) -> str:
    """Return the distance and direction of a mark from a robot, such as ``goal 1.50 m, 30° left``.

    Args:
        planar: [3] x and y in metres and yaw in radians of the robot.
        mark: the mark.
    """
    x, y = (mark.planar[:2] - planar[:2]).double().tolist()
    turn = math.degrees(math.remainder(math.atan2(y, x) - float(planar[2]), math.tau))
    side = "ahead" if abs(turn) <= AHEAD_DEG else f"{abs(turn):.0f}° {'left' if turn > 0 else 'right'}"
    return f"{mark.name} {math.hypot(x, y):.2f} m, {side}"
