"""How far a reconstruction is from the truth, where that is known: for rendered videos, and for sensors."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.array_files import read_arrays
from splatrl.capture.base import Reconstruction
from splatrl.capture.world import Placed
from splatrl.files import refusing

Floats = NDArray[np.float64]
MOST_BYTES = 2**28
"""Maximum size of its arrays: room for the poses of a video of hours."""
KEYS = {"camera_to_world": (None, 4, 4), "time": (None,), "K": (3, 3)}


@dataclass(frozen=True)
class Truth:
    """Where the camera of a video was.

    Attributes:
        camera_to_world: [F, 4, 4] float64, metres, world frame, OpenCV camera axes.
        time: [F] float64, seconds from the first frame, ascending.
        K: [3, 3] float64, intrinsics of the video's images, pixels.
    """

    camera_to_world: Tensor
    time: Tensor
    K: Tensor


@dataclass(frozen=True)
class Deviation:
    """How far a placed reconstruction is from the truth.

    Attributes:
        world_from_capture: [4, 4] float64 similarity that brings its cameras closest to the true ones.
        path: root-mean-square distance of the cameras after that, relative to the path's length.
        metres: the same in metres.
        turn_deg: median angle between found and true cameras after that, degrees.
        up_deg: angle between its up and the true one, degrees.
        scale: relative error of its lengths: 0.02 where a metre is given as 1.02.
        focal: relative error of its focal length.
    """

    world_from_capture: Tensor
    path: float
    metres: float
    turn_deg: float
    up_deg: float
    scale: float
    focal: float


def read_truth(video: Path) -> Truth:
    """Read the .npz beside a video: ``camera_to_world``, ``time`` and ``K``, as ``phone_video`` writes it.

    Raises:
        FileNotFoundError: where there is none.
        ValueError: for another file, missing keys, or values of other shapes.
    """
    path = video.with_suffix(".npz")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected the ground truth of {video.name}, found no file")
    stored, found = read_arrays(path, MOST_BYTES), {}
    with refusing(path, f"a .npz with {', '.join(KEYS)}"):
        for key in KEYS:
            found[key] = np.asarray(stored[key], np.float64)
    count = len(found["time"]) if found["time"].ndim else 0
    for key, shape in KEYS.items():
        expected = tuple(count if side is None else side for side in shape)
        if found[key].shape != expected or not np.isfinite(found[key]).all() or count < 2:
            raise ValueError(
                f"{path}: {key}: expected finite numbers of shape {expected}, got shape {found[key].shape}"
            )
    return Truth(*(torch.from_numpy(found[key]) for key in ("camera_to_world", "time", "K")))


def true_poses(reconstruction: Reconstruction, truth: Truth) -> Tensor:
    """Return the true poses [N, 4, 4] of a reconstruction's cameras, by the times at which they took their images.

    Raises:
        ValueError: where the reconstruction does not know these times.
    """
    if reconstruction.seconds is None:
        raise ValueError("seconds: expected the times at which the images were taken, got none")
    return poses_at(reconstruction.seconds, truth)


def poses_at(seconds: Tensor, truth: Truth) -> Tensor:
    """Return the true poses [N, 4, 4] at the frames nearest to some times [N], seconds."""
    return truth.camera_to_world[(seconds[:, None] - truth.time).abs().argmin(1)]


def closest_similarity(found: Tensor, true: Tensor) -> Tensor:
    """Return the similarity that brings points closest to others (Umeyama 1991): [N, 3], [N, 3] -> [4, 4] float64."""
    a, b = found.double().numpy(), true.double().numpy()
    middle_a, middle_b = a.mean(0), b.mean(0)
    u, stretch, vt = np.linalg.svd((b - middle_b).T @ (a - middle_a))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    linear = (u * signs) @ vt * float((stretch * signs).sum() / max(((a - middle_a) ** 2).sum(), 1e-300))
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = linear, middle_b - linear @ middle_a
    return torch.from_numpy(transform)


def distances(found: Tensor, true: Tensor) -> Tensor:
    """Return how far points are from others once a similarity has brought them closest: [N, 3], [N, 3] -> [N]."""
    transform = closest_similarity(found, true)
    return (found @ transform[:3, :3].T + transform[:3, 3] - true).norm(dim=1)


def deviation(placed: Placed, truth: Truth, width: int) -> Deviation:
    """Compare a placed reconstruction with the truth.

    Args:
        placed: the reconstruction; its cameras know when they took their images.
        truth: the truth, in a world with z up.
        width: width of the images to which the truth's K belongs, pixels.
    """
    reconstruction = placed.reconstruction
    poses, true = reconstruction.camera_to_world, true_poses(reconstruction, truth)
    transform = closest_similarity(poses[:, :3, 3], true[:, :3, 3])
    scale = float(transform[:3, :3].det() ** (1 / 3))
    turn = transform[:3, :3] / scale
    metres = float(distances(poses[:, :3, 3], true[:, :3, 3]).square().mean().sqrt())
    length = float(truth.camera_to_world[:, :3, 3].diff(dim=0).norm(dim=1).sum())
    between = torch.einsum("nij,nij->n", turn @ poses[:, :3, :3], true[:, :3, :3])
    focal = float(reconstruction.K[0, 0]) / reconstruction.width / (float(truth.K[0, 0]) / width) - 1
    return Deviation(
        world_from_capture=transform,
        path=metres / length,
        metres=metres,
        turn_deg=math.degrees(float(((between - 1) / 2).clamp(-1, 1).acos().median())),
        up_deg=math.degrees(math.acos(min(1.0, float(turn[2, 2])))),
        scale=1 / scale - 1,
        focal=focal,
    )
