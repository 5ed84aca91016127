"""Placed models, for batches in which a camera sees more than a single scene in its own frame."""

from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.geometry import first_not_rigid, rigid

ABSENT = -1
"""Model index of a part that shows nothing, so that rows of a batch may have different numbers of parts."""


class Parts(NamedTuple):
    """For each row of a batch, up to M models of a renderer and their poses.

    All parts of a row are drawn into one image: their Gaussians are sorted by depth and blended together, so parts
    occlude each other exactly. At equal depths the part that comes first is in front. A row without parts shows the
    background.

    Attributes:
        model: [B, M] int64, index into the renderer's models; ``ABSENT`` (−1) for none.
        model_to_world: [B, M, 4, 4] float32, rigid, metres; ignored where ``model`` is ``ABSENT``.
    """

    model: Tensor
    model_to_world: Tensor

    def rows(self, rows: slice | Tensor) -> "Parts":
        """Select the parts of some rows of the batch by a slice, a mask [B] bool or indices [R] int64."""
        return Parts(self.model[rows], self.model_to_world[rows])


def in_scenes(scene: Tensor, parts: Parts | None, like: Tensor) -> Parts:
    """Combine a scene for each row, at the identity pose, with the parts that stand in it.

    Args:
        scene: [B] int64, the model that is the scene of each row.
        parts: further parts in the scene; None for none.
        like: a pose that gives the dtype and device.
    """
    model, standing = scene.unsqueeze(1), torch.eye(4, dtype=like.dtype, device=like.device).expand(len(scene), 1, 4, 4)
    if parts is None:
        return Parts(model, standing)
    return Parts(torch.cat([model, parts.model], 1), torch.cat([standing, parts.model_to_world], 1))


def require_parts_of(parts: Parts, cameras: Cameras) -> None:
    """Reject parts that do not match a batch of cameras, without looking at their values.

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
    """Check parts as every renderer on the host does, and return them unchanged.

    Args:
        parts: the parts of each row; None if model 0 is drawn.
        cameras: B views.
        models: the number of models that the renderer has.

    Raises:
        ValueError: for another shape or type, or for a model that does not exist or a pose that is not rigid (the
            message names its row and part).
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
    """Express each row's camera in the frame of each of its parts, so that harmonics need not be rotated.

    Args:
        cameras: B views.
        parts: the parts of the B rows.

    Returns:
        [B, M, 4, 4] float32, metres, computed in double precision and rounded once, independently of the rest of the
        batch; for a part with the identity pose it is ``camera_to_world``.
    """
    model_to_world = parts.model_to_world.double()
    camera_to_world = cameras.camera_to_world.double().unsqueeze(1)
    axes, to_camera = camera_to_world[..., :3, :3], camera_to_world[..., :3, 3] - model_to_world[..., :3, 3]
    seen = torch.cat([axes.expand(*to_camera.shape, 3), to_camera.unsqueeze(-1)], -1)  # [B, M, 3, 4]
    x, y, z = (  # not a matrix product, whose order of summation may depend on the batch
        model_to_world[..., axis, :3].unsqueeze(-1) * seen[..., axis, :].unsqueeze(-2) for axis in range(3)
    )
    turned = x + y + z
    return rigid(turned[..., :3], turned[..., 3]).float()
