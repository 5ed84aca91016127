"""Quality check of a fitted capture: held-out images, free space along the camera's path, and floaters."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.cameras import Cameras
from splatrl.capture.area import Area, path_is_free, survey_area
from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.floaters import seen_through
from splatrl.capture.pictures import comparison_line, comparison_rows, draw_comparison, draw_map
from splatrl.capture.progress import Progress, silent
from splatrl.capture.suggestions import NOTHING, Suggestions
from splatrl.capture.unchanging import left_out_at
from splatrl.capture.videos import shrunk, shrunk_size
from splatrl.capture.world import Placed
from splatrl.images import read_photo
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

COMPARISON, MAP = "held_out.png", "map.png"
LONGEST = 960
"""Maximum pixels along the longer side of held-out images, as films and photos have: figures of recordings whose images
are larger are for images of this size, too."""
SIGMA = 1.5
"""Standard deviation, pixels, of the window of the structural similarity (Wang et al. 2004), 11 × 11 pixels."""


@dataclass(frozen=True)
class Quality:
    """Measures of a capture's quality.

    Attributes:
        psnr: mean PSNR of the held-out images, dB.
        ssim: mean structural similarity of the held-out images.
        psnr_corrected: mean PSNR once each channel of a render has been fitted to its photo by a gain and an offset,
            dB.
        ssim_corrected: mean structural similarity after the same correction.
        held_out: number of held-out images, which were never fitted; with none, the four above are None.
        path_free: fraction of the cameras around which a sphere with a radius of 5 cm is free.
        solid: number of solid voxels.
        floating: number of solid voxels that many cameras saw through.
        voxel_size: edge of a voxel, metres.
        problems: what is wrong with the capture, one sentence each; empty where this was not looked for.
    """

    psnr: float | None
    ssim: float | None
    psnr_corrected: float | None
    ssim_corrected: float | None
    held_out: int
    path_free: float
    solid: int
    floating: int
    voxel_size: float
    problems: tuple[str, ...] = ()

    def figures(self) -> dict[str, float | int | None]:
        """Return the numbers by name, rounded to four significant digits."""
        numbers = {name: value for name, value in asdict(self).items() if name != "problems"}
        return {name: float(f"{value:.4g}") if isinstance(value, float) else value for name, value in numbers.items()}


def check(
    gaussians: Gaussians,
    placed: Placed,
    held_out: Sequence[int],
    folder: Path,
    area: Area | None = None,
    found: Suggestions = NOTHING,
    progress: Progress = silent,
) -> Quality:
    """Compare a fitted capture with what its cameras saw, and draw ``held_out.png`` and ``map.png``.

    Args:
        gaussians: the fitted Gaussians, world frame.
        placed: cameras and points in the world.
        held_out: indices of the images that were never fitted.
        folder: folder for the pictures; it must exist.
        area: the result of ``survey_area``; None computes it.
        found: suggested goals and object position, to mark on the map.
        progress: called for every held-out image.

    Raises:
        CaptureError: for an image that cannot be read, or whose size differs from the reconstruction's.
    """
    area = survey_area(gaussians, placed) if area is None else area
    free = path_is_free(area.occupancy, placed.reconstruction.camera_to_world)
    scores, lines, drawn = [], [], comparison_rows(len(held_out))
    width, height = shrunk_size((placed.reconstruction.width, placed.reconstruction.height), LONGEST)
    dark = left_out_at(placed.reconstruction, height, width)
    counted = np.ones((height, width), bool) if dark is None else ~dark.numpy()
    for row, (photo, render) in enumerate(_views(gaussians, placed.reconstruction, held_out)):
        corrected = colour_corrected(render, photo, counted)
        images, measures = (render, corrected), (psnr, ssim)
        scores.append([measure(image, photo, counted=counted) for image in images for measure in measures])
        if row in drawn:
            lines.append(comparison_line(photo, render, scores[row][0]))
        progress("check", row + 1, len(held_out))
    if lines:
        draw_comparison(lines, folder / COMPARISON)
    draw_map(gaussians, placed, area, free.numpy(), folder / MAP, found.goals, found.thing)
    plain, structure, corrected_plain, corrected_structure = np.mean(scores, 0).tolist() if scores else [None] * 4
    return Quality(
        psnr=plain,
        ssim=structure,
        psnr_corrected=corrected_plain,
        ssim_corrected=corrected_structure,
        held_out=len(scores),
        path_free=float(free.double().mean()),
        solid=area.occupancy.count,
        floating=int(seen_through(area.occupancy, placed.reconstruction).sum()),
        voxel_size=area.occupancy.resolution,
    )


def psnr(image: Floats, reference: Floats, counted: Mask | None = None) -> float:
    """Return the peak signal-to-noise ratio of images [H, W, 3] in [0, 1], dB; at most 100.

    Args:
        image: an image.
        reference: what it should show.
        counted: [H, W] pixels that count; None counts all.
    """
    errors = (image - reference) ** 2
    return float(-10 * np.log10(max(float(np.mean(errors if counted is None else errors[counted])), 1e-10)))


def ssim(image: Floats, reference: Floats, counted: Mask | None = None) -> float:
    """Return the mean structural similarity of images [H, W, 3] in [0, 1] (Wang et al. 2004, eq. 13), per channel.

    Args:
        image: an image.
        reference: what it should show.
        counted: [H, W] pixels that count; None counts all.
    """

    def local(values: Floats) -> Floats:
        blurred: Floats = ndimage.gaussian_filter(values, (SIGMA, SIGMA, 0.0), radius=(5, 5, 0))
        return blurred

    a, b = local(image), local(reference)
    covariance = local(image * reference) - a * b
    variances = local(image**2) - a**2 + local(reference**2) - b**2
    c1, c2 = 0.01**2, 0.03**2
    alike = (2 * a * b + c1) * (2 * covariance + c2) / ((a**2 + b**2 + c1) * (variances + c2))
    return float(np.mean(alike if counted is None else alike[counted]))


def colour_corrected(image: Floats, reference: Floats, counted: Mask | None = None) -> Floats:
    """Return an image with each channel fitted to that of a reference by a gain and an offset, by least squares.

    Args:
        image: an image.
        reference: what it should show.
        counted: [H, W] pixels to which it is fitted; None takes all.
    """
    result, some = np.empty_like(image), slice(None) if counted is None else counted
    for channel in range(3):
        x, y = image[some][..., channel], reference[some][..., channel]
        variance = float(x.var())
        factor = float(((x - x.mean()) * (y - y.mean())).mean()) / variance if variance > 1e-9 else 0.0
        result[..., channel] = np.clip(factor * (image[..., channel] - x.mean()) + y.mean(), 0.0, 1.0)
    return result


def _views(
    gaussians: Gaussians, reconstruction: Reconstruction, rows: Sequence[int]
) -> Iterator[tuple[Floats, Floats]]:
    """Yield the photo and the render of each of some cameras, [H, W, 3] in [0, 1], at most ``LONGEST`` pixels long."""
    renderer = NativeRenderer(gaussians)
    full = reconstruction.width, reconstruction.height
    width, height = shrunk_size(full, LONGEST)
    K = reconstruction.K_at(width, height).float()
    for row in rows:
        path = reconstruction.paths[row]
        try:
            photo = read_photo(path)
        except (OSError, ValueError) as error:
            raise CaptureError(f"{path}: expected an image, got {error}") from error
        if photo.size != full:
            raise CaptureError(f"{path}: expected {full[0]} × {full[1]} pixels, got {photo.width} × {photo.height}")
        pose = reconstruction.camera_to_world[row : row + 1].float()
        with torch.no_grad():
            pixels = renderer.pixels(Cameras(pose, K, width, height))[0]
        yield np.asarray(shrunk(photo, LONGEST), np.float64) / 255.0, pixels.numpy().astype(np.float64) / 255.0
