"""A hilly scene, whole and in blocks, that the tests of renderers share."""

from pathlib import Path

import torch

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.scenes import Gaussians, Scene, read_scene
from splatrl.scenes.blocks import BlockScene
from splatrl.scenes.splitting import write_split
from tests.renderers.cases import random_gaussians

SIZE = (48, 36)


def hilly(count: int = 12_000) -> Gaussians:
    """Return hills of 24 × 16 m; a camera among them sees Gaussians at all ranges."""
    g = torch.Generator().manual_seed(7)
    cloud = random_gaussians(8, count)
    x, y = 24 * torch.rand(count, generator=g), 16 * torch.rand(count, generator=g)
    cloud.means = torch.stack([x, y, 0.4 * torch.sin(x) + 0.3 * torch.sin(2 * y)], 1)
    cloud.scales = 0.04 + 0.06 * torch.rand(count, 3, generator=g)
    cloud.sh = (torch.sin(torch.stack([x, y, x + y], 1)) + 0.3 * torch.randn(count, 3, generator=g)).unsqueeze(1)
    return cloud


def hills(count: int = 12_000) -> Scene:
    """Return the hills as one scene."""
    return Scene("hills", hilly(count), ((0.0, 0.0, -1.0), (24.0, 16.0, 1.0)))


def in_blocks(folder: Path, whole: Scene, edge: float) -> BlockScene:
    """Write a scene to a folder in blocks with this edge length, and return it read back."""
    write_split(folder, whole, edge)
    scene = read_scene(folder)
    assert isinstance(scene, BlockScene)
    return scene


def walkers(seed: int = 1, batch: int = 24) -> Cameras:
    """Return cameras that stand among the hills and look around."""
    g = torch.Generator().manual_seed(seed)
    eyes = torch.rand(batch, 3, generator=g) * torch.tensor([24.0, 16.0, 0.5]) + torch.tensor([0.0, 0.0, 0.8])
    turns = 6.3 * torch.rand(batch, generator=g)
    targets = eyes + torch.stack([torch.cos(turns), torch.sin(turns), torch.full((batch,), -0.15)], 1)
    poses = [look_at(eye.tolist(), target.tolist()) for eye, target in zip(eyes, targets, strict=True)]
    return Cameras(torch.stack(poses), intrinsics(1.3, *SIZE), *SIZE)
