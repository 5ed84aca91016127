"""A renderer for policies that do not use images."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.renderers.base import RenderOutput
from splatrl.renderers.parts import Parts


class NoRenderer:
    """Draws nothing: every image is black.

    Args:
        scene: ignored; accepted for compatibility with the other renderers.
        options: ignored in the same way.
    """

    def __init__(self, scene: Any | Sequence[Any], **options: Any):
        pass

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        """Return black images with a depth and alpha of zero; see ``RenderOutput``."""
        plane = torch.zeros(len(cameras), cameras.height, cameras.width, device=cameras.camera_to_world.device)
        return RenderOutput(plane.unsqueeze(-1).repeat(1, 1, 1, 3), plane, plane.clone())

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        """Return zeros: [B, H, W, 3] uint8."""
        shape = (len(cameras), cameras.height, cameras.width, 3)
        return torch.zeros(shape, dtype=torch.uint8, device=cameras.camera_to_world.device)
