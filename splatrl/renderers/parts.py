"""Placed models: what each camera of a batch sees when that is more than one scene where it stands."""

from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import first_not_rigid, rigid

ABSENT = -1
"""The model of a part that shows nothing: rows of a batch may have different numbers of parts."""


class Parts(NamedTuple):
    """For each row of a batch, up to M models of a renderer and where they stand.

    All parts of a row are drawn into one image: their Gaussians are sorted by depth and blended together, so parts hide
    each other exactly. At equal depths the part that comes first is in front. A row without parts shows the background.

    Attributes:
        model: [B, M] int64, which of the renderer's models; ``ABSENT`` (−1) for none.
        model_to_world: [B, M, 4, 4] float32, rigid, metres; ignored where ``model`` is ``ABSENT``.
    """

    model: Tensor
    model_to_world: Tensor

    def rows(self, rows: slice | Tensor) -> "Parts":
        """The parts of some rows of the batch: a slice, a mask or indices."""
        return Parts(self.model[rows], self.model_to_world[rows])


def in_scenes(scene: Tensor, parts: Parts | None, like: Tensor) -> Parts:
    """What rows see that are each in a scene of their own: the scene where it stands, then its parts.

    Args:
        scene: [B] int64, which of the renderer's models is the scene of each row.
        parts: what else stands in it; None for nothing.
        like: a pose, for its type and device.
    """
    model, standing = scene.unsqueeze(1), torch.eye(4, dtype=like.dtype, device=like.device).expand(len(scene), 1, 4, 4)
    if parts is None:
        return Parts(model, standing)
    return Parts(torch.cat([model, parts.model], 1), torch.cat([standing, parts.model_to_world], 1))


def require_parts_of(parts: Parts, cameras: Cameras) -> None:
    """Refuse parts that do not belong to a batch of cameras, without looking at their values.

    Raises:
        ValueError: for another shape or type than [B, M] int64 and [B, M, 4, 4] float32.
    """
    model, poses = parts
    if model.ndim != 2 or len(model) != len(cameras) or model.dtype != torch.int64:
        raise ValueError(
            f"parts.model: expected [{len(cameras)}, M] torch.int64, got {list(model.shape)} {model.dtype}"
        )
    if poses.shape != (*model.shape, 4, 4) or poses.dtype != torch.float32:
        expected = [*model.shape, 4, 4]
        raise ValueError(
            f"parts.model_to_world: expected {expected} torch.float32, got {list(poses.shape)} {poses.dtype}"
        )


def checked_parts(parts: Parts | None, cameras: Cameras, models: int) -> Parts | None:
    """Check parts as every renderer on the host does, and return them as they are.

    Args:
        parts: of each row; None where model 0 is drawn.
        cameras: B views.
        models: how many the renderer has.

    Raises:
        ValueError: for another shape or type, or, by row and part, for a model that does not exist or a pose that is
            not rigid.
    """
    if parts is None:
        return None
    require_parts_of(parts, cameras)
    unknown = (parts.model < ABSENT) | (parts.model >= models)
    if unknown.any():
        row, part = unknown.nonzero()[0].tolist()
        choices = f"{ABSENT} or a model in [0, {models})"
        raise ValueError(f"parts.model[{row}, {part}]: expected {choices}, got {int(parts.model[row, part])}")
    present = (parts.model != ABSENT).nonzero()
    poses = parts.model_to_world.detach()[present.unbind(1)]
    fault = first_not_rigid(poses)
    if fault is not None:
        row, part = present[fault[0]].tolist()
        raise ValueError(f"parts.model_to_world[{row}, {part}]: expected {fault[1]}, got {poses[fault[0]].tolist()}")
    return parts


def camera_to_models(cameras: Cameras, parts: Parts) -> Tensor:
    """The pose of each row's camera in the frame of each of its parts, so that harmonics need no rotation.

    Args:
        cameras: B views.
        parts: of the B rows.

    Returns:
        [B, M, 4, 4] float32, metres, computed in double precision and rounded once, independently of the batch;
        a part that stands at the origin gives ``camera_to_world``.
    """
    model_to_world = parts.model_to_world.double()
    camera_to_world = cameras.camera_to_world.double().unsqueeze(1)
    axes, to_camera = camera_to_world[..., :3, :3], camera_to_world[..., :3, 3] - model_to_world[..., :3, 3]
    seen = torch.cat([axes.expand(*to_camera.shape, 3), to_camera.unsqueeze(-1)], -1)  # [B, M, 3, 4]
    x, y, z = (  # a product of matrices may be summed in another order in another batch
        model_to_world[..., axis, :3].unsqueeze(-1) * seen[..., axis, :].unsqueeze(-2) for axis in range(3)
    )
    turned = x + y + z
    return rigid(turned[..., :3], turned[..., 3]).float()
