"""What moved while photos were taken: people, animals, cars.

A small fit shows what the photos have in common. Where one shows something else, although others of the same place look
as the fit does, something was in the way. What is suspected is left out while the small fit goes on, so that it shows
more of what is behind, and the next round decides better.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from splatrl.cameras import Cameras, depths_at, pixel_places
from splatrl.capture.base import Reconstruction
from splatrl.capture.fit import FitSettings, Fitting, trained
from splatrl.capture.fit_pictures import Pictures, frame_of, pictures
from splatrl.capture.progress import Progress, silent
from splatrl.capture.stereo import Depths, confirmed, resized
from splatrl.renderers import NativeRenderer

ROUNDS = 3
SHARE = 0.64
"""Of the views of the whole fit: what the small one draws, on images as large as the depths, which are a quarter."""
GAUSSIANS = 8_000
"""Of the small fit, at most, and no more than the whole one may have."""
SMOOTH = 2.0
"""Pixels over which differences are averaged, so that fine texture that is not drawn yet does not count."""
GAINS = (0.7, 1.4)
"""Between which a photo's exposure may differ from the fit's."""
STEADY = 0.02
"""Differences below this count in full where the exposure is sought, larger ones the less the larger they are."""
SUSPECT, UNLIKE, CLEAR = 0.06, 0.08, 0.15
"""Differences, of 1: of what is left out at first, of each pixel of a thing, and of a thing on average."""
AGREEING = 3
"""Other photos that must show what the fit shows there, and more than those that do not."""
SAME = 0.08
"""A photo shows the same place if it is as far away, but for this share."""
THROUGH = 0.88
"""A photo sees through a place if the place is nearer than this share of what the photo shows."""
ASKED = 100
"""Other photos that are asked, at most."""
APART = 3
"""They are farther than this in the order of the photos: what moves slowly is in those too."""
LARGE = 1 / 90
"""Of an image: a thing is no smaller."""
GROWN = 6
"""Pixels of half the size by which a thing grows into what is suspect around it, whatever others say of that."""
CONFIRMED = 0.5
"""Share of a thing's pixels whose depth other photos confirm: of what moves it is less."""
OPAQUE = 0.5
"""A pixel at least this opaque shows how far away things are."""

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]


def find_moving(
    reconstruction: Reconstruction, depths: Depths, settings: FitSettings, progress: Progress = silent
) -> Tensor:
    """Find the pixels of photos that show what moved.

    Args:
        reconstruction: photos with poses.
        depths: of their pixels, as ``find_depths`` returns them.
        settings: of the fit that is to come, on which it depends how long this takes.
        progress: told about views of the small fit.

    Returns:
        [N, H, W] bool, as large as the depths; nothing of photos that are never fitted.

    Raises:
        CaptureError: as ``fit`` does.
    """
    small = replace(
        settings,
        width=depths.known.shape[2],
        cap=min(GAUSSIANS, settings.cap),
        views=max(1, round(settings.views * SHARE)),
        levels=((0.0, 1.0),),
        sh_degree=0,
        device="cpu",
    )
    rows, frame = trained(len(reconstruction.paths)), frame_of(reconstruction.camera_to_world)
    if reconstruction.depths:  # a sensor measures what moves, too
        (seen,) = pictures(reconstruction, frame, [depths.known.shape[2]])
        depths = confirmed(depths, seen, rows, small.threads)
    depths = replace(depths, likely=depths.known)  # what nobody confirms may have moved
    fitting = Fitting(reconstruction, small, depths)
    seen, _ = fitting.level(0.0)
    moving = torch.zeros_like(depths.known, dtype=torch.bool)
    steps = math.ceil(small.views / fitting.views)
    ends = [round(steps * (number + 1) / ROUNDS) for number in range(ROUNDS)]
    for step in range(steps):
        fitting.step(step, steps)
        progress("moving", step + 1, steps)
        if step + 1 in ends:
            last = step + 1 == steps
            found = compared(fitting, seen, reconstruction, moving, depths.known > 0)
            moving[rows] = resized(found.things(last).float(), moving.shape[1:]) > 0
            fitting.levels = {1.0: (seen, depths.without(moving).at(seen, rows))}
    return moving


@dataclass(frozen=True)
class Comparison:
    """How photos differ from a fit, and what other photos say of these places, at half the size.

    Attributes:
        known: [R, h, w] bool, whether other photos confirm the depth of a pixel.
        unlike: [R, h, w] float32, how different a photo is there, of 1, averaged over some pixels.
        agreeing: [R, h, w] int16, how many of the others show the place that the fit shows there, and look like it.
        disagreeing: how many show that place, and look different.
        through: how many see through it.
    """

    known: Tensor
    unlike: Tensor
    agreeing: Tensor
    disagreeing: Tensor
    through: Tensor

    def things(self, strict: bool) -> Tensor:
        """The pixels of what moved, or without ``strict`` of what may have: [R, h, w] bool.

        Args:
            strict: whether to find only large and clear things, about whose place other photos agree with the fit.
        """
        clear = (self.unlike > UNLIKE) & (self.agreeing >= AGREEING) & (self.agreeing > self.disagreeing)
        ghosts = (self.through >= AGREEING) & (self.through > 2 * (self.agreeing + self.disagreeing))
        candidates = (clear if strict else (self.unlike > SUSPECT) | ghosts).numpy()
        known, found = self.known.numpy(), np.zeros_like(candidates)
        for row, (pixels, unlike) in enumerate(zip(candidates, self.unlike.numpy(), strict=True)):
            pixels = ndimage.binary_opening(pixels, np.ones((3, 3) if strict else (2, 2)))
            labels, count = ndimage.label(pixels)
            each = np.arange(1, count + 1)
            kept = ndimage.mean(known[row], labels, each) < CONFIRMED
            if strict:
                kept &= ndimage.sum(pixels, labels, each) >= LARGE * pixels.size
                kept &= ndimage.mean(unlike, labels, each) > CLEAR
            things = np.isin(labels, each[kept])
            if strict:
                things |= ndimage.binary_dilation(things, iterations=GROWN, mask=(unlike > SUSPECT) & ~known[row])
            found[row] = _rounded(things)
        return torch.from_numpy(found)


def compared(
    fitting: Fitting, seen: Pictures, reconstruction: Reconstruction, ignored: Tensor, known: Tensor
) -> Comparison:
    """Compare the photos that a fit is trained on with it.

    Args:
        fitting: the fit.
        seen: its photos.
        reconstruction: their poses.
        ignored: [N, H, W] bool, pixels that do not count where exposures are sought.
        known: [N, H, W] bool, whether other photos confirm the depth of a pixel; elsewhere a photo that looks as the
            fit does has no vote, since where the sky is nobody knows.
    """
    rows, (height, width) = fitting.trained, seen.pixels.shape[1:3]
    poses = reconstruction.camera_to_world[rows]
    renderer = NativeRenderer(fitting.model.gaussians(fitting.frame), threads=fitting.threads)
    drawn = renderer.render(Cameras(poses.float(), seen.K, width, height))
    apart = [
        difference(view.double().numpy(), seen.pixels[row].numpy() / 255.0, ignored[row].numpy())
        for view, row in zip(drawn.rgb, rows.tolist(), strict=True)
    ]
    unlike = torch.from_numpy(np.stack(apart)).float()
    unlike = torch.nn.functional.avg_pool2d(unlike[:, None], 2)[:, 0]
    height, width = unlike.shape[1:]
    depth = torch.where(drawn.alpha > OPAQUE, drawn.depth, 0.0)[:, : 2 * height : 2, : 2 * width : 2]
    known = known[rows][:, : 2 * height : 2, : 2 * width : 2]
    alike = torch.where(known, depth, 0.0)
    signed = torch.where(unlike < SUSPECT, alike, -depth)  # positive where a photo looks as the fit does
    K, counts = reconstruction.K_at(width, height), torch.zeros(3, len(rows), height, width, dtype=torch.int16)
    for row, pose in enumerate(poses):
        places = pixel_places(depth[row], pose, K)
        for other in asked(row, len(rows)):
            z, told = depths_at(places, signed[other], poses[other], K, 0.0)
            far = told.abs()
            same = (z - far).abs() < SAME * far
            votes = torch.stack([same & (told > 0), same & (told < 0), (far > 0) & (z < THROUGH * far)])
            counts[:, row] += (votes & (depth[row].reshape(-1) > 0)).view(3, height, width)
    return Comparison(known, unlike, *counts)


def difference(drawn: Floats, photo: Floats, ignored: Mask) -> Floats:
    """How a photo differs from what is drawn, but for a gain and an offset of each channel.

    These are sought by what is alike: larger differences count less, the more so the larger they are.

    Args:
        drawn: [H, W, 3] in [0, 1].
        photo: likewise.
        ignored: [H, W] bool, pixels that do not count for gain and offset.

    Returns:
        [H, W]: the largest of the channels, averaged over some pixels with their signs.
    """
    counted = 1.0 - ignored[..., None]
    weights, apart = np.broadcast_to(counted, drawn.shape), np.zeros_like(drawn)
    for _ in range(4):
        total = np.maximum(weights.sum((0, 1)), 1e-6)
        from_drawn, from_photo = (values - (weights * values).sum((0, 1)) / total for values in (drawn, photo))
        spread = np.maximum((weights * from_drawn**2).sum((0, 1)), 1e-6)
        gain = np.clip((weights * from_drawn * from_photo).sum((0, 1)) / spread, *GAINS)
        apart = gain * from_drawn - from_photo
        weights = counted / np.maximum(np.abs(apart), STEADY)
    largest: Floats = np.abs(ndimage.gaussian_filter(apart, (SMOOTH, SMOOTH, 0.0))).max(-1)
    return largest


def asked(row: int, count: int) -> list[int]:
    """Which of ``count`` photos are asked about one of them."""
    others = [other for other in range(count) if abs(other - row) > APART]
    stride = max(1, -(-len(others) // ASKED))
    return others[row % stride :: stride]


def _rounded(pixels: Mask) -> Mask:
    """Without holes and gaps, and a pixel larger."""
    closed = ndimage.binary_closing(np.pad(pixels, 3, mode="edge"), np.ones((5, 5)))[3:-3, 3:-3]
    whole: Mask = ndimage.binary_dilation(ndimage.binary_fill_holes(closed))
    return whole
