"""Simulated phone film of a walk: a video with blur, noise and drifting exposure, and its ground truth."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics
from splatrl.evaluation.encoding import encode
from splatrl.evaluation.phone_walk import camera_poses
from splatrl.files import replacing
from splatrl.hdr import GAMMA
from splatrl.renderers.base import Renderer
from splatrl.values import require_number

DRIFT = 17.0
"""Period of the exposure drift, seconds."""
PLATE = 64
"""Pixels by which the noise pattern is larger than a frame in each direction: each frame crops it at random."""


@dataclass(frozen=True)
class Phone:
    """Camera of a simulated phone.

    Attributes:
        width: width of the video, pixels; even.
        height: height of the video, pixels; even.
        fps: frames per second.
        fov_deg: horizontal field of view, degrees.
        shutter: time for which the shutter is open, seconds.
        glimpses: number of views within the shutter time that are averaged into a frame; 1 gives no motion blur.
        drift: largest change of the exposure in either direction, stops.
        noise: standard deviation of the noise in each channel value, grey levels.
    """

    width: int = 1920
    height: int = 1080
    fps: int = 30
    fov_deg: float = 69.0
    shutter: float = 0.005
    glimpses: int = 2
    drift: float = 0.15
    noise: float = 2.0

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            if getattr(self, name) < 2 or getattr(self, name) % 2:
                raise ValueError(f"{name}: expected an even number of pixels, got {getattr(self, name)}")
        for name in ("fps", "glimpses"):
            require_number(name, getattr(self, name), 1, whole=True)

    @property
    def K(self) -> Tensor:
        """Intrinsics [3, 3], pixels."""
        return intrinsics(math.radians(self.fov_deg), self.width, self.height)


def phone_video(
    renderer: Renderer,
    walk: Tensor,
    phone: Phone,
    path: Path,
    seed: int = 0,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> Path:
    """Film a walk as H.264, and write the ground truth to a .npz beside it.

    The ground truth holds ``camera_to_world`` [N, 4, 4] in the middle of each exposure, ``K`` [3, 3] in pixels and
    ``time`` [N] in seconds, all float64.

    Args:
        renderer: renderer of the scene.
        walk: [N, 6] as returned by ``phone_walk``.
        phone: the phone's camera.
        path: path of the video, ending in .mp4.
        seed: seed of the noise and the exposure.
        progress: called with the number of frames filmed and their total.

    Returns:
        Path of the ground truth.
    """
    truth = path.with_suffix(".npz")
    encode(_frames(renderer, walk, phone, seed, progress), path, phone.fps)
    with replacing(truth) as stream:
        np.savez(
            stream,
            camera_to_world=camera_poses(walk).numpy(),
            K=phone.K.double().numpy(),
            time=np.arange(len(walk)) / phone.fps,
        )
    return truth


def _frames(
    renderer: Renderer, walk: Tensor, phone: Phone, seed: int, progress: Callable[[int, int], object]
) -> Iterator[Image.Image]:
    random = np.random.default_rng(seed)
    plate = random.normal(0.0, phone.noise, (phone.height + PLATE, phone.width + PLATE, 3)).round().astype(np.int16)
    stops = phone.drift * np.sin(math.tau * (np.arange(len(walk)) / (DRIFT * phone.fps) + random.random()))
    speeds = torch.gradient(walk, dim=0)[0] * phone.fps
    moments = phone.shutter * ((torch.arange(phone.glimpses) + 0.5) / phone.glimpses - 0.5)
    for number in range(len(walk)):
        seen = walk[number] + moments.unsqueeze(1).double() * speeds[number]
        cameras = Cameras(camera_poses(seen).float(), phone.K, phone.width, phone.height)
        views = renderer.pixels(cameras).numpy()
        view = views[0] if len(views) == 1 else (views.sum(0, dtype=np.uint16) // len(views)).astype(np.uint8)
        row, column = random.integers(0, PLATE, 2)
        grain = plate[row : row + phone.height, column : column + phone.width]
        yield Image.fromarray(np.clip(_exposed(2.0 ** stops[number])[view] + grain, 0, 255).astype(np.uint8))
        progress(number + 1, len(walk))


def _exposed(gain: float) -> NDArray[np.int16]:
    """Tabulate how an exposure gain, applied to linear light, maps each of the 256 channel values: [256]."""
    values = 255.0 * ((np.arange(256) / 255.0) ** GAMMA * gain) ** (1 / GAMMA)
    return np.clip(values.round(), 0, 255).astype(np.int16)
