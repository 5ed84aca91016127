"""Measures how well and how fast Gaussians are fitted to photos with known poses.

    python benchmarks/fit.py [--scene backyard|kitchen] [--video FILE.mp4] [--width 320] [--cap 60000] [--views 7000]

Without a video, a walk around the backyard is rendered. Prints the PSNR and SSIM of the held-out views, the PSNR after
an affine colour correction of each, the views fitted per second at full resolution, and the CPU time. ``--look FOLDER``
saves the held-out views beside their photos.
"""

import argparse
import math
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from fit_capture import filmed_capture, rendered_capture
from PIL import Image
from torch import Tensor
from tqdm import tqdm

import splatrl
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.capture.base import Reconstruction
from splatrl.capture.fitting.fit import FitSettings, Fitting, fit, held_out
from splatrl.capture.fitting.pictures import frame_of, pictures
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians

TIMED = 100
"""Number of steps over which speed is measured."""


def walk(frames: int) -> Tensor:
    """Return poses on a loop through the backyard that looks outwards and around: [N, 4, 4]."""
    turn = torch.linspace(0, 2 * math.pi, frames + 1)[:-1]
    eye = torch.stack([1.2 * turn.cos(), 0.8 * turn.sin(), 0.5 + 0.15 * (3 * turn).sin()], 1)
    yaw = turn + 0.8 * (5 * turn).sin()
    aim = eye + torch.stack([yaw.cos(), yaw.sin(), -0.1 + 0.1 * (7 * turn).cos()], 1)
    return look_at(eye, aim)


def similarity(a: Tensor, b: Tensor) -> float:
    """Return the mean SSIM of images [N, H, W, 3] in [0, 1], with the window of the loss."""
    distance = torch.arange(-5.0, 6.0)
    window = torch.exp(-(distance**2) / (2 * 1.5**2))
    kernel = torch.outer(window, window)[None, None] / window.sum() ** 2

    def smooth(x: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(x.movedim(-1, 1).flatten(0, 1).unsqueeze(1), kernel)

    mean_a, mean_b = smooth(a), smooth(b)
    var_a, var_b, mixed = smooth(a * a) - mean_a**2, smooth(b * b) - mean_b**2, smooth(a * b) - mean_a * mean_b
    top = (2 * mean_a * mean_b + 1e-4) * (2 * mixed + 9e-4)
    return float((top / ((mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4))).mean())


def corrected(views: Tensor, photos: Tensor) -> Tensor:
    """Return the views, each with the affine colour transform that fits it best to its photo."""
    out = []
    for view, photo in zip(views, photos, strict=True):
        known = torch.cat([view.flatten(0, 1), torch.ones(view.shape[0] * view.shape[1], 1)], 1)
        out.append((known @ torch.linalg.lstsq(known, photo.flatten(0, 1)).solution).view_as(photo).clamp(0, 1))
    return torch.stack(out)


def psnr(a: Tensor, b: Tensor) -> float:
    """Return the PSNR, averaged over the images, dB."""
    return float((-10 * (a - b).square().flatten(1).mean(1).log10()).mean())


def judge(gaussians: Gaussians, reconstruction: Reconstruction, width: int, look: Path | None) -> None:
    """Print the quality of the held-out views, rendered as robots see them."""
    (seen,) = pictures(reconstruction, frame_of(reconstruction.camera_to_world), [width])
    rows = held_out(len(reconstruction.paths))
    photos = seen.pixels[rows].float() / 255
    height = photos.shape[1]
    cameras = Cameras(reconstruction.camera_to_world[rows].float(), seen.K, width, height)
    views = NativeRenderer(gaussians).render(cameras).rgb
    plain, fitted = (psnr(views, photos), similarity(views, photos)), psnr(corrected(views, photos), photos)
    print(f"held out: {plain[0]:.2f} dB, SSIM {plain[1]:.3f}; colour-corrected {fitted:.2f} dB ({len(rows)} views)")
    if look is not None:
        look.mkdir(parents=True, exist_ok=True)
        for row, view, photo in zip(rows.tolist(), views, photos, strict=True):
            both = (torch.cat([view, photo], 1) * 255).byte().numpy()
            Image.fromarray(np.ascontiguousarray(both)).save(look / f"{row:05d}.png")


def speed(reconstruction: Reconstruction, settings: FitSettings, gaussians: Gaussians) -> None:
    """Print how many views per second a finished fit processes at full resolution."""
    fitting = Fitting(reconstruction, settings)
    model, frame = fitting.model, fitting.frame
    model.count = 0
    columns = torch.zeros(model.values.shape[0], len(gaussians))
    columns[0:3] = ((gaussians.means.double() - frame.middle) / frame.extent).T.float()
    columns[3:6] = (gaussians.scales / frame.extent).log().T
    columns[6:10], columns[10] = gaussians.quats.T, gaussians.opacities.logit()
    columns[11:] = gaussians.sh.flatten(1).T
    model.add(columns)
    for warm in (True, False):
        began, used = time.perf_counter(), time.process_time()
        for _ in range(TIMED // 10 if warm else TIMED):
            fitting.step(TIMED * 100 - 1, TIMED * 100 + 1)
    views = TIMED * settings.views_a_step
    wall, cpu = time.perf_counter() - began, time.process_time() - used
    print(f"{len(gaussians)} Gaussians: {views / wall:.1f} views per second, {1000 * cpu / views:.1f} CPU ms per view")


def capture_of(args: argparse.Namespace, folder: Path) -> Reconstruction:
    """Make the capture that the options describe."""
    if args.scene == "backyard":
        scene = splatrl.backyard()
    else:
        turn = {"axes": ["x", "-z", "y"]}
        scene = splatrl.read_scene(args.splat, world_from_splat=turn)
    if args.video is not None:
        return filmed_capture(scene, args.video, args.frames, args.photo_width, folder)
    size = (args.photo_width, args.photo_width * 9 // 16)
    return rendered_capture(scene, walk(args.frames), intrinsics(math.radians(75), *size), size, folder)


def main() -> None:
    """Fit, and print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=["backyard", "kitchen"], default="backyard")
    parser.add_argument("--splat", type=Path, help="splat file of the kitchen")
    parser.add_argument("--video", type=Path)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--photo-width", type=int, default=640)
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--cap", type=int, default=60_000)
    parser.add_argument("--views", type=int, default=7_000)
    parser.add_argument("--degree", type=int, default=1)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--device", default="cpu", help="cuda fits on a GPU")
    parser.add_argument("--look", type=Path)
    args = parser.parse_args()
    if args.scene == "kitchen" and args.splat is None:
        parser.error("--scene kitchen: expected --splat FILE")
    settings = FitSettings(
        args.width, args.cap, args.views, sh_degree=args.degree, threads=args.threads, device=args.device
    )
    with tempfile.TemporaryDirectory() as folder, tqdm(total=args.views, unit="view") as bar:
        reconstruction = capture_of(args, Path(folder))
        began, used = time.perf_counter(), time.process_time()

        def show(done: int, total: int, loss: float) -> None:
            bar.update(done - bar.n)
            bar.set_postfix(loss=f"{loss:.4f}", refresh=False)

        gaussians = fit(reconstruction, settings, show)
        wall, cpu = time.perf_counter() - began, time.process_time() - used
        bar.close()
        print(f"{len(gaussians)} Gaussians in {wall:.1f} s, {cpu:.1f} CPU s")
        judge(gaussians, reconstruction, args.width, args.look)
        speed(reconstruction, settings, gaussians)


if __name__ == "__main__":
    main()
