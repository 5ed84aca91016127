"""Captures with known ground truth as input of a fit: images of a walk through a scene, and points on its surfaces."""

from pathlib import Path

import av
import numpy as np
import torch
from PIL import Image
from torch import Tensor

from splatrl.cameras import Cameras, depths_at
from splatrl.capture.base import Reconstruction
from splatrl.renderers import NativeRenderer
from splatrl.scenes.scene import Scene

NOISE = 0.002
"""Standard deviation of the points' depth noise, relative to the depth."""
AGREES = 0.02
"""Maximum relative deviation of the depth at which a camera counts as seeing a point."""


def rendered_capture(scene: Scene, poses: Tensor, K: Tensor, size: tuple[int, int], folder: Path) -> Reconstruction:
    """Render photos of a scene from poses [N, 4, 4] into a folder, and add points on its surfaces."""
    cameras = Cameras(poses.float(), K.float(), *size)
    renderer = NativeRenderer(scene)
    paths = []
    for row in range(len(poses)):
        image = renderer.pixels(cameras[row : row + 1])[0].numpy()
        paths.append(folder / f"{row:05d}.png")
        Image.fromarray(image).save(paths[-1])
    return surveyed(scene, paths, poses, K, size)


def filmed_capture(scene: Scene, video: Path, frames: int, width: int, folder: Path) -> Reconstruction:
    """Extract frames of a video with its poses in a .npz beside it, and add points on the surfaces of its scene."""
    known = np.load(video.with_suffix(".npz"))
    count = len(known["camera_to_world"])
    chosen = sorted({round(i) for i in np.linspace(0, count - 1, frames)})
    paths = []
    with av.open(str(video)) as container:
        for number, frame in enumerate(container.decode(video=0)):
            if number not in chosen:
                continue
            image = frame.to_image()
            full = image.size
            height = round(image.height * width / image.width)
            paths.append(folder / f"{number:05d}.png")
            image.resize((width, height), Image.Resampling.BOX).save(paths[-1])
    K = torch.from_numpy(known["K"]) * torch.tensor([[width / full[0]], [height / full[1]], [1.0]])
    return surveyed(scene, paths, torch.from_numpy(known["camera_to_world"])[chosen], K, (width, height))


def surveyed(
    scene: Scene, paths: list[Path], poses: Tensor, K: Tensor, size: tuple[int, int], points: int = 3000
) -> Reconstruction:
    """Make a reconstruction with points at random pixels, whose depth is noisy, and the cameras that see each point."""
    random = torch.Generator().manual_seed(0)
    cameras = Cameras(poses.float(), K.float(), *size)
    rendered = NativeRenderer(scene)
    depths = torch.stack([rendered.render(cameras[row : row + 1]).depth[0] for row in range(len(poses))]).double()
    rows = torch.randint(0, len(poses), (points,), generator=random)
    columns, lines = (torch.randint(0, bound, (points,), generator=random) for bound in size)
    far = depths[rows, lines, columns] * (1 + NOISE * torch.randn(points, generator=random, dtype=torch.float64))
    rays = torch.stack([(columns + 0.5 - K[0, 2]) / K[0, 0], (lines + 0.5 - K[1, 2]) / K[1, 1], torch.ones(points)], 1)
    placed = poses.double()[rows]
    world = (placed[:, :3, :3] @ (rays * far[:, None]).double().unsqueeze(-1)).squeeze(-1) + placed[:, :3, 3]
    images = [np.asarray(Image.open(path)) for path in paths]
    colors = np.stack([images[row][line, column] for row, line, column in zip(rows, lines, columns, strict=True)])
    world, colors = world[far > 0], colors[(far > 0).numpy()]
    seen_point, seen_by = [], []
    for row, pose in enumerate(poses.double()):
        z, found = depths_at(world, depths[row], pose, K.double(), 0.05)
        sees = ((found > 0) & ((found - z).abs() < AGREES * z)).nonzero().squeeze(1)
        seen_point.append(sees)
        seen_by.append(torch.full_like(sees, row))
    return Reconstruction(
        paths,
        *size,
        K.double(),
        poses.double(),
        world,
        torch.from_numpy(colors.copy()),
        torch.cat(seen_point),
        torch.cat(seen_by),
    )
