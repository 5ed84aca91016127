"""A robot on the page: its position, its view, and the state of its episode."""

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.bodies import Box
from splatrl.envs.robot import Robot
from splatrl.envs.tasks.base import Outcome
from splatrl.evaluation.chart import COLORS
from splatrl.geometry import rotations_to_quats

if TYPE_CHECKING:
    import viser

SEEN = 320
"""Shorter side of the robot's view in the panel, pixels."""
SMALLEST = 0.12
"""Smallest size of a robot's mark, metres, so that even centimetre-sized bodies are visible."""
WEDGE = np.array([[1.0, 0, 0], [-0.6, 0.55, 0], [-0.6, -0.55, 0], [-0.35, 0, 0.35]], np.float32)
"""A mark that points along +x."""
FACES = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]], np.uint32)
BLUE = (31, 111, 235)


def wedge(robot: Robot) -> NDArray[np.float32]:
    """Return the corners of a robot's mark, as large as its body but always visible: [4, 3] metres, body frame."""
    reach = 0.5 * max(robot.body.size[:2]) if isinstance(robot.body, Box) else robot.body.radius
    return WEDGE * max(reach, SMALLEST)


def enlarged(pixels: Tensor) -> NDArray[np.uint8]:
    """Enlarge an image [H, W, 3] by an integer factor, so that its shorter side is about ``SEEN`` pixels."""
    times = max(1, round(SEEN / min(pixels.shape[:2])))
    return pixels.cpu().numpy().repeat(times, 0).repeat(times, 1)


def words(outcome: Outcome) -> str:
    """Return an outcome in words."""
    return outcome.name.replace("_", " ").lower()


def tone(outcome: Outcome) -> tuple[int, int, int]:
    """Return the colour of an outcome, the same as in figures and videos; blue while running."""
    if outcome is Outcome.RUNNING:
        return BLUE
    return rgb(COLORS[outcome])


def rgb(color: str) -> tuple[int, int, int]:
    """Convert a colour such as ``#e0409f`` to numbers from 0 to 255."""
    red, green, blue = (int(color[at : at + 2], 16) for at in (1, 3, 5))
    return red, green, blue


class RobotShown:
    """A robot drawn over the splats, with its camera's view and its trail.

    Args:
        server: server of the page.
        name: scene node of the robot, such as ``/robot``.
        robot: body and camera.
    """

    def __init__(self, server: "viser.ViserServer", name: str, robot: Robot):
        self.server, self.name, self.robot = server, name, robot
        corners = wedge(robot)
        blank = np.zeros((robot.image_height, robot.image_width, 3), np.uint8)
        fov = 2 * math.atan(0.5 * robot.image_height / float(robot.K[1, 1]))
        aspect = robot.image_width / robot.image_height
        self.root = server.scene.add_frame(name, show_axes=False)
        size = float(
            corners.max()
        )  # as large as the mark: the picture would hide a small room, and the panel has it too
        self.frustum = server.scene.add_camera_frustum(f"{name}/camera", fov, aspect, scale=size, image=blank)
        self.body = server.scene.add_mesh_simple(f"{name}/body", corners, FACES, color=BLUE, side="double")
        self.trail: list[tuple[float, float, float]] = []
        self._line: viser.LineSegmentsHandle | None = None

    def show(self, body_to_world: Tensor, pixels: Tensor, outcome: Outcome, begins: bool) -> None:
        """Show the robot's pose and view.

        Args:
            body_to_world: [4, 4], metres.
            pixels: [H, W, 3] uint8.
            outcome: outcome of the episode so far.
            begins: whether an episode, and therefore a new trail, begins here.
        """
        cameras = self.robot.cameras(body_to_world.unsqueeze(0))
        poses = torch.stack([body_to_world, cameras.camera_to_world[0]]).cpu()
        quats, places = rotations_to_quats(poses[:, :3, :3]).numpy(), poses[:, :3, 3].numpy()
        x, y, z = places[0].tolist()
        self.trail = [(x, y, z)] if begins else [*self.trail, (x, y, z)]
        with self.server.atomic():
            self.body.wxyz, self.body.position, self.body.color = quats[0], places[0], tone(outcome)
            self.frustum.wxyz, self.frustum.position, self.frustum.image = quats[1], places[1], pixels.cpu().numpy()
            self._draw_trail(tone(outcome))

    def _draw_trail(self, color: tuple[int, int, int]) -> None:
        if self._line is not None and len(self.trail) == 1:
            self._line.remove()
            self._line = None
        if len(self.trail) > 1:
            points = np.array(self.trail, np.float32)
            lines = np.stack([points[:-1], points[1:]], 1)
            moved = lines[np.abs(lines[:, 0] - lines[:, 1]).max(1) > 0]  # a segment of zero length has no direction
            if len(moved):
                name = f"{self.name}/trail"
                self._line = self.server.scene.add_line_segments(name, moved, color, thickness=0.015)
