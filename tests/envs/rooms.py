"""Envs off the lattice in the tiny room, with coarse motions that are quick to plan, and a painted apple."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.curriculum import Curriculum, Plan, plan
from splatrl.envs import SplatEnv
from splatrl.envs.drawing import SceneDrawing
from splatrl.envs.tasks import Apple, Drive
from splatrl.motions import DriveMotion, ForwardMotion
from splatrl.renderers import Parts, RenderOutput
from splatrl.renderers.base import draw_only
from tests.tiny import HEIGHT, BlockChecker, tiny_renderer, tiny_robot

BOUNDS: dict[str, Any] = {"lower": (-1.0, -1.5), "upper": (1.0, 1.5)}
PLACE = (0.75, 1.0, HEIGHT)
"""Position of the apple."""


class RedEast:
    """Paints a view red if the camera looks east, and otherwise a grey that is brighter than any apple."""

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        return draw_only(self._painted, cameras, parts, only)

    def _painted(self, cameras: Cameras, parts: Parts | None) -> Tensor:
        east = cameras.camera_to_world[:, 0, 2] > 0.9
        colors = torch.where(east[:, None], torch.tensor([200, 0, 0]), torch.tensor([230, 230, 230])).to(torch.uint8)
        return colors[:, None, None].expand(len(cameras), cameras.height, cameras.width, 3).clone()

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        raise NotImplementedError


def coarse_forward() -> ForwardMotion:
    """Make steps of 0.25 m and quarter turns: walks stay on the lattice of starts, 9 × 13 places and 4 headings."""
    return ForwardMotion(HEIGHT, 0.25, 90.0, **BOUNDS)


def coarse_apple(motion: ForwardMotion | None = None, **settings: Any) -> Apple:
    """Make the apple task with coarse steps; the apple counts as found from one step away."""
    return Apple(motion or coarse_forward(), PLACE, **settings)


@cache
def apple_plan() -> Plan:
    """Plan paths to the apple around the block."""
    task = coarse_apple()
    return plan(task.motion, BlockChecker(), task.reached)


def painted_env(task: Apple, batch: int, seed: int = 0, **curriculum: Any) -> SplatEnv:
    """Make an env with painted views, so that a robot's heading determines what it sees."""
    levels = Curriculum(apple_plan(), **{"first": None, **curriculum})
    return SplatEnv(SceneDrawing(RedEast()), BlockChecker(), tiny_robot(), task, levels, [batch], seed)


def coarse_drive() -> Drive:
    """Make a drive task with at most 0.25 m and a quarter turn per time step of half a second."""
    motion = DriveMotion(HEIGHT, 0.5, angular_deg=180.0, spacing=0.25, headings=4, **BOUNDS)
    return Drive(motion, (0.5, 1.0, 0.0), max_steps=20)


@cache
def drive_plan() -> Plan:
    """Plan paths around the block."""
    task = coarse_drive()
    return plan(task.motion, BlockChecker(), task.reached)


def drive_env(batch_size: Sequence[int] = (1,), seed: int = 0) -> SplatEnv:
    """Make an env of robots with wheels in the tiny room."""
    curriculum = Curriculum(drive_plan(), None)
    return SplatEnv(
        SceneDrawing(tiny_renderer()), BlockChecker(), tiny_robot(), coarse_drive(), curriculum, batch_size, seed
    )
