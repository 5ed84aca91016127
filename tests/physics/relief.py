"""Grounds of known shape: their voxels, and the depth that a perfect renderer would draw."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.collision import Occupancy
from splatrl.renderers.base import RenderOutput
from splatrl.renderers.parts import Parts

Surface = Callable[[Tensor, Tensor], Tensor]
"""z at x and y, metres."""


class ReliefRenderer:
    """Renders the exact depth of a surface z = f(x, y) seen from above, optionally with noise."""

    def __init__(self, surface: Surface, noise: float = 0.0):
        self.surface, self.noise = surface, noise

    def render(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> RenderOutput:
        pose, K = cameras.camera_to_world.double(), cameras.K[0].double()
        row, column = (torch.arange(count) + 0.5 for count in (cameras.height, cameras.width))
        row, column = torch.meshgrid(row, column, indexing="ij")
        rays = torch.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], torch.ones_like(row)], -1)
        ray = torch.einsum("bij,hwj->bhwi", pose[:, :3, :3], rays.double())
        eye = pose[:, None, None, :3, 3]
        depth = torch.zeros(ray.shape[:3], dtype=torch.float64)
        for _ in range(30):
            x, y, _ = (eye + depth.unsqueeze(-1) * ray).unbind(-1)
            depth = (self.surface(x, y) - eye[..., 2]) / ray[..., 2]
        depth += self.noise * torch.randn(depth.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        return RenderOutput(torch.zeros(*depth.shape, 3), depth.float(), torch.ones(depth.shape))

    def pixels(self, cameras: Cameras, parts: Parts | None = None, only: Tensor | None = None) -> Tensor:
        raise NotImplementedError("only depth is drawn")


def relief_voxels(surface: Surface, half: tuple[float, float] = (1.6, 1.2), edge: float = 0.05) -> Occupancy:
    """Return the voxels that a surface passes through and five below each, within ±``half`` of the origin."""
    x, y = (np.arange(-round(side / edge), round(side / edge)) for side in half)
    at = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    place = torch.from_numpy((at + 0.5) * edge)
    top = np.floor(surface(place[:, 0], place[:, 1]).numpy() / edge).astype(np.int64)
    keys = [np.append(at, (top - below)[:, None], 1) for below in range(6)]
    return Occupancy.from_keys(np.concatenate(keys), edge)
