"""The tiny room as a capture: cameras placed around the block, and the images that they take."""

from pathlib import Path

import torch
from PIL import Image

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.capture.base import Reconstruction
from splatrl.capture.world import Placed
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians
from tests.tiny import tiny_gaussians

WIDTH, HEIGHT = 96, 64
CAMERAS = 24
ABOVE = 0.5
FLOATER = (0.9, 0.0, 0.5)
"""Centre of an added blob: a place on the cameras' path where the room is empty."""
HAZE = (0.7, 1.2, 0.5)


def tiny_capture(folder: Path, exposure: float = 1.0) -> Placed:
    """Return cameras that circle the block, world frame; write their images, scaled by an exposure, to a folder."""
    turn = torch.linspace(0, 6.0, CAMERAS)
    eyes = torch.stack([0.9 * turn.cos(), 1.3 * turn.sin(), torch.full((CAMERAS,), ABOVE)], 1)
    aims = torch.stack([1.5 * (turn + 0.9).cos(), 2.0 * (turn + 0.9).sin(), torch.full((CAMERAS,), 0.45)], 1)
    poses, K = look_at(eyes, aims), intrinsics(1.5, WIDTH, HEIGHT)
    gaussians = tiny_gaussians()
    pixels = NativeRenderer(gaussians).pixels(Cameras(poses, K, WIDTH, HEIGHT))
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{row:02d}.png" for row in range(CAMERAS)]
    for path, image in zip(paths, pixels, strict=True):
        Image.fromarray((image.float() * exposure).byte().numpy()).save(path)
    points = gaussians.means.double()
    local = torch.einsum("nji,npj->npi", poses[:, :3, :3].double(), points - poses[:, None, :3, 3].double())
    plane = local @ K.double().T
    seen = (local[..., 2] > 0.2) & (plane[..., :2] >= 0).all(2)
    seen &= (plane[..., 0] < WIDTH * local[..., 2]) & (plane[..., 1] < HEIGHT * local[..., 2])
    through_block = torch.stack([hidden(pose[:3, 3], points) for pose in poses.double()])
    seen_by, seen_point = (seen & ~through_block).nonzero().T
    colors = (255 * (gaussians.sh[:, 0] * 0.2821 + 0.5).clamp(0, 1)).byte()
    reconstruction = Reconstruction(
        paths, WIDTH, HEIGHT, K.double(), poses.double(), points, colors, seen_point, seen_by
    )  # fmt: skip
    return Placed(reconstruction, torch.eye(4).double(), "recorded", 0.01, "recorded", 1.0, ABOVE, 63)


def hidden(eye: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Return whether the block, or the air above it, lies between an eye and each of the points [P, 3]: [P] bool."""
    along = torch.linspace(0.02, 0.9, 60).double()[:, None, None]
    places = eye + along * (points - eye)
    return (places[..., :2].abs() < 0.3).all(2).any(0)


def with_cloud(middle: tuple[float, float, float], reach: int, scale: float, opacity: float) -> Gaussians:
    """Return the room with a cube of black Gaussians in mid-air, 5 cm apart, ``reach`` of them to each side."""
    steps = 0.05 * torch.cartesian_prod(*[torch.arange(-reach, reach + 1.0)] * 3)
    count = len(steps)
    cloud = Gaussians(
        means=torch.tensor(middle) + steps,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), scale),
        opacities=torch.full((count,), opacity),
        sh=torch.zeros(count, 1, 3),
        batch_size=[count],
    )
    return torch.cat([tiny_gaussians(), cloud])


def with_floater() -> Gaussians:
    """Return the room with a dense blob in mid-air."""
    return with_cloud(FLOATER, 1, 0.05, 0.95)


def with_haze() -> Gaussians:
    """Return the room with haze in front of a wall: many Gaussians that no image shows, yet whose density adds up."""
    return with_cloud(HAZE, 2, 0.004, 0.75)
