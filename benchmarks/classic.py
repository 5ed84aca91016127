"""How near small classic and antialiased images are to what a classic splat looks like at the size of its training.

``python benchmarks/classic.py playbot.sog --up 0,-1,0`` compares 64×64 images with large classic ones, averaged down.
"""

import argparse

import torch
from quality import psnr, shown, supersampled

from splatrl.cameras import Cameras
from splatrl.renderers import NativeRenderer
from splatrl.scenes import Gaussians, read_gaussians

SIZE, VIEWS = 64, 12


def around(gaussians: Gaussians, up: list[float]) -> Cameras:
    """Return cameras on a circle around what is opaque, which look at its middle from slightly above."""
    places = gaussians.means[gaussians.opacities > 0.5]
    places = places[torch.linspace(0, len(places) - 1, 100_000).long()]
    low, high = torch.quantile(places, torch.tensor([0.05, 0.95]), 0)
    top = torch.tensor(up)
    ahead = torch.linalg.cross(top, torch.tensor([0.3, 0.5, 0.8]))
    side = torch.linalg.cross(top, ahead)
    angles = torch.arange(VIEWS) * 2 * torch.pi / VIEWS
    away = angles.cos()[:, None] * ahead / ahead.norm() + angles.sin()[:, None] * side / side.norm()
    forward = -torch.nn.functional.normalize(0.45 * away + 0.2 * top, dim=1)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, top.expand_as(forward)), dim=1)
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward], 2)
    poses = torch.eye(4).repeat(VIEWS, 1, 1)
    poses[:, :3, :3], poses[:, :3, 3] = rotation, (low + high) / 2 - 0.49 * (high - low).norm() * forward
    K = torch.tensor([[SIZE / 2, 0.0, SIZE / 2], [0.0, SIZE / 2, SIZE / 2], [0.0, 0.0, 1.0]])
    return Cameras(poses, K, SIZE, SIZE)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", help="a splat that was trained without antialiasing")
    parser.add_argument("--up", default="0,0,1", help="up in the file")
    options = parser.parse_args()
    splat = read_gaussians(options.file)
    cameras = around(splat, [float(value) for value in options.up.split(",")])
    truth = supersampled(NativeRenderer(splat, antialiased=False), cameras)
    for antialiased in (False, True):
        image = shown(NativeRenderer(splat, antialiased), cameras)
        print(
            f"{'antialiased' if antialiased else 'classic':11} {float(psnr(image, truth).mean()):.1f} dB, "
            f"{float(image.mean() / truth.mean()):.2f} times as bright"
        )
