"""A synthetic walk in the backyard, in the form that structure from motion returns, with known ground truth."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

import splatrl
from splatrl.cameras import intrinsics, look_at
from splatrl.capture.base import Reconstruction
from splatrl.capture.world import moved

WIDTH, HEIGHT = 320, 180
CAMERAS = 40
ABOVE = 1.4
"""Height of the cameras above the lawn, metres."""
K = intrinsics(1.2, WIDTH, HEIGHT).double()


@cache
def walk() -> Reconstruction:
    """Return a walk around the yard, looking inwards and down, in the world frame, with noise and stray points."""
    generator = torch.Generator().manual_seed(0)
    turn = torch.linspace(0, 6.0, CAMERAS)
    sway = 0.03 * torch.randn(CAMERAS, 3, generator=generator)
    eyes = torch.stack([1.5 * turn.cos(), 1.7 * turn.sin(), torch.full((CAMERAS,), ABOVE)], 1) + sway
    aims = torch.stack([-0.3 * turn.cos(), -0.3 * turn.sin(), torch.full((CAMERAS,), 0.4)], 1)
    tilt = torch.cat([0.05 * torch.randn(CAMERAS, 2, generator=generator), torch.ones(CAMERAS, 1)], 1)
    poses = look_at(eyes, aims, tilt).double()
    gaussians = splatrl.backyard().gaussians
    small = (gaussians.opacities > 0.5) & (gaussians.scales.amax(1) < 0.2) & (gaussians.means.abs().amax(1) < 3.2)
    rows = small.nonzero()[:, 0]
    rows = rows[torch.randperm(len(rows), generator=generator)[:6000]]
    points = gaussians.means[rows].double() + 0.006 * torch.randn(len(rows), 3, generator=generator).double()
    points[:60] += 0.4 * torch.randn(60, 3, generator=generator).double()
    seen = torch.stack([visible(poses[camera], points) for camera in range(CAMERAS)])
    seen_by, seen_point = seen.nonzero().T
    colors = (255 * (gaussians.sh[rows, 0] * 0.2821 + 0.5).clamp(0, 1)).byte()
    paths = [Path(f"{camera:03d}.png") for camera in range(CAMERAS)]
    return Reconstruction(paths, WIDTH, HEIGHT, K, poses, points, colors, seen_point, seen_by)


def visible(camera_to_world: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Return which points [P, 3] a camera sees: in its image, close enough, and not hidden by others in their cell."""
    local = (points - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    pixels = (local @ K.T)[:, :2] / local[:, 2:]
    inside = (local[:, 2] > 0.3) & (local[:, 2] < 5.0) & (pixels >= 0).all(1)
    inside &= (pixels[:, 0] < WIDTH) & (pixels[:, 1] < HEIGHT)
    cells = (pixels[:, 1] // 8).long() * (WIDTH // 8) + (pixels[:, 0] // 8).long()
    nearest = torch.full((WIDTH * HEIGHT // 64 + WIDTH,), torch.inf, dtype=torch.float64)
    nearest.scatter_reduce_(0, cells[inside], local[inside, 2], "amin")
    result = inside.clone()
    result[inside] = local[inside, 2] < nearest[cells[inside]] + 0.3
    return result


def similarity_of(seed: int) -> NDArray[np.float64]:
    """Return a random rotation, scale and shift: [4, 4]."""
    generator = np.random.default_rng(seed)
    rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    transform = np.eye(4)
    transform[:3, :3] = np.exp(generator.uniform(-1.5, 1.5)) * rotation
    transform[:3, 3] = generator.normal(size=3)
    return transform


def strewn(seed: int) -> tuple[Reconstruction, NDArray[np.float64]]:
    """Return the walk in a random frame and unit, and the similarity that moved it there."""
    transform = similarity_of(seed)
    return moved(walk(), transform), transform


def without_points(reconstruction: Reconstruction, kept: torch.Tensor) -> Reconstruction:
    """Return a reconstruction with only the points that a mask keeps."""
    new = torch.cumsum(kept, 0) - 1
    rows = kept[reconstruction.seen_point]
    return replace(
        reconstruction,
        points=reconstruction.points[kept],
        colors=reconstruction.colors[kept],
        seen_point=new[reconstruction.seen_point[rows]],
        seen_by=reconstruction.seen_by[rows],
    )
