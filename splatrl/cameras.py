"""A batch of pinhole cameras."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from splatrl.geometry import rigid

MOST_PIXELS = 65536
"""Maximum width and height of an image."""


@dataclass(frozen=True)
class Cameras:
    """Pinhole cameras that share an image size.

    Attributes:
        camera_to_world: [B, 4, 4] float32, metres, world frame, OpenCV camera axes.
        K: [B, 3, 3] float32 intrinsics in pixels; [3, 3] is expanded to the batch.
        width: image width in pixels.
        height: image height in pixels.

    Raises:
        ValueError: for shapes other than these, or an image without pixels or with too many.
    """

    camera_to_world: Tensor  # [B, 4, 4]
    K: Tensor  # [B, 3, 3]
    width: int
    height: int

    def __post_init__(self) -> None:
        for name in ("camera_to_world", "K"):
            if not isinstance(value := getattr(self, name), Tensor):
                raise ValueError(f"{name}: expected a tensor, got {value!r:.80}")
        if self.camera_to_world.ndim != 3 or self.camera_to_world.shape[1:] != (4, 4):
            raise ValueError(f"camera_to_world: expected shape [B, 4, 4], got {list(self.camera_to_world.shape)}")
        batch = self.camera_to_world.shape[0]
        if self.K.ndim == 2:
            object.__setattr__(self, "K", self.K.expand(batch, *self.K.shape))
        if self.K.shape != (batch, 3, 3):
            raise ValueError(f"K: expected shape [{batch}, 3, 3] or [3, 3], got {list(self.K.shape)}")
        for name, side in (("width", self.width), ("height", self.height)):
            if isinstance(side, bool) or not isinstance(side, int) or not 1 <= side <= MOST_PIXELS:
                raise ValueError(f"{name}: expected a whole number of pixels from 1 to {MOST_PIXELS}, got {side!r}")

    def __len__(self) -> int:
        return self.camera_to_world.shape[0]

    def __getitem__(self, rows: slice | Tensor) -> "Cameras":
        """Select some rows of the batch, by a slice, a mask or indices."""
        return Cameras(self.camera_to_world[rows], self.K[rows], self.width, self.height)


def intrinsics(fov: float, width: int, height: int) -> Tensor:
    """Return intrinsics with square pixels and a centred principal point.

    Args:
        fov: horizontal field of view, radians, in (0, π).
        width: image width, pixels.
        height: image height, pixels.

    Returns:
        K [3, 3] float32.

    Raises:
        ValueError: for a field of view outside (0, π).
    """
    if not 0.0 < fov < math.pi:
        raise ValueError(f"fov: expected an angle in (0, π) radians, got {fov}")
    focal = 0.5 * width / math.tan(0.5 * fov)
    rows = [[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]]
    return torch.tensor(rows, dtype=torch.float32)


def look_at(
    position: Tensor | Sequence[float],
    target: Tensor | Sequence[float],
    up: Tensor | Sequence[float] = (0.0, 0.0, 1.0),
) -> Tensor:
    """Return the pose of a camera at ``position`` that looks at ``target``.

    Args:
        position: [..., 3] world, metres.
        target: [..., 3] world, metres, different from ``position``.
        up: [..., 3] world; where it is parallel to the line of sight, +y is used instead.

    Returns:
        camera_to_world [..., 4, 4] float32.
    """
    eye, aim, above = (torch.as_tensor(v, dtype=torch.float32) for v in (position, target, up))
    eye, aim, above = torch.broadcast_tensors(eye, aim, above)
    forward = torch.nn.functional.normalize(aim - eye, dim=-1)
    right = torch.linalg.cross(forward, above)
    spare = torch.linalg.cross(forward, torch.tensor([0.0, 1.0, 0.0]).expand_as(forward))
    right = torch.where(right.norm(dim=-1, keepdim=True) < 1e-6, spare, right)
    right = torch.nn.functional.normalize(right, dim=-1)
    return rigid(torch.stack([right, torch.linalg.cross(forward, right), forward], -1), eye)


def depths_at(
    points: Tensor, depth: Tensor, camera_to_world: Tensor, K: Tensor, nearest: float
) -> tuple[Tensor, Tensor]:
    """Return the depth of points seen from a camera, and the depth that its depth image has at their pixels.

    Args:
        points: [M, 3] float64, world, metres.
        depth: [H, W] along the optical axis, metres.
        camera_to_world: [4, 4] float64 pose of the camera.
        K: [3, 3] float64 intrinsics for images of that size, pixels.
        nearest: points no deeper than this count as outside the image, metres.

    Returns:
        [M] depth of the points; [M] depth in the image, 0 for points outside it.
    """
    height, width = depth.shape
    x, y, z = ((points - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]).unbind(1)
    column, row = (K[0, 0] * x / z + K[0, 2]).floor().long(), (K[1, 1] * y / z + K[1, 2]).floor().long()
    inside = (z > nearest) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    said = depth.double()[row.clamp(0, height - 1), column.clamp(0, width - 1)]
    return z, torch.where(inside, said, 0.0)


def pixel_places(depth: Tensor, camera_to_world: Tensor, K: Tensor) -> Tensor:
    """Unproject the pixels of a depth image into the world.

    Args:
        depth: [H, W] along the optical axis, metres.
        camera_to_world: [4, 4] float64 pose of the camera.
        K: [3, 3] float64 intrinsics for images of that size, pixels.

    Returns:
        [H · W, 3] float64, world, metres, row by row.
    """
    height, width = depth.shape
    down, across = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    rays = torch.stack([(across - K[0, 2]) / K[0, 0], (down - K[1, 2]) / K[1, 1], torch.ones_like(across)], -1)
    local = (rays * depth[..., None]).reshape(-1, 3).double()
    return local @ camera_to_world[:3, :3].T + camera_to_world[:3, 3]
