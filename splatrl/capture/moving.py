"""Find what moved while photos were taken: people, animals, cars.

A small fit shows what the photos have in common. Where a photo shows something else, although others of the same place
look like the fit, something was in the way. Suspect pixels are masked out while the small fit goes on, so that it shows
more of what is behind them, and the next round decides better.
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
from splatrl.capture.fitting.fit import FitSettings, Fitting, trained
from splatrl.capture.fitting.pictures import Pictures, frame_of, pictures
from splatrl.capture.progress import Progress, silent
from splatrl.capture.stereo import Depths, confirmed, resized
from splatrl.renderers import NativeRenderer

ROUNDS = 3
SHARE = 0.64
"""Views of the small fit, as a fraction of the whole fit's; its images are as large as the depth maps, with a quarter
of the pixels."""
GAUSSIANS = 8_000
"""Maximum number of Gaussians in the small fit; the cap of the whole fit limits them, too."""
SMOOTH = 2.0
"""Standard deviation, pixels, of the blur of differences, so that fine texture that is not fitted yet does not
count."""
GAINS = (0.7, 1.4)
"""Range of gains by which a photo's exposure may differ from the fit's."""
STEADY = 0.02
"""Differences up to this have full weight when the exposure is estimated; beyond it, the weight falls as they grow."""
SUSPECT, UNLIKE, CLEAR = 0.06, 0.08, 0.15
"""Minimum differences, on a scale of 0 to 1: of what is masked out at first, of each pixel of a moving thing, and of a
moving thing on average."""
AGREEING = 3
"""Minimum number of other photos that must show what the fit shows there; they must also outnumber those that look
different."""
SAME = 0.08
"""Relative tolerance in depth within which a photo shows the same place."""
THROUGH = 0.88
"""A photo sees through a place that is nearer than this fraction of the depth that the photo shows there."""
ASKED = 100
"""Maximum number of other photos that each photo is compared with."""
APART = 3
"""They are more than this many photos away: things that move slowly are in nearer photos, too."""
LARGE = 1 / 90
"""Minimum size of a moving thing, as a fraction of the image."""
GROWN = 6
"""Pixels, at half the size, by which a thing grows into suspect pixels around it, whatever other photos show there."""
CONFIRMED = 0.5
"""A thing moved only if other photos confirm the depth of less than this fraction of its pixels."""
OPAQUE = 0.5
"""Minimum alpha at which the depth of a rendered pixel counts."""

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]


def find_moving(
    reconstruction: Reconstruction, depths: Depths, settings: FitSettings, progress: Progress = silent
) -> Tensor:
    """Find the pixels of photos that show moving things.

    Args:
        reconstruction: photos with poses.
        depths: depths of their pixels, as ``find_depths`` returns them, perhaps without what never changes.
        settings: settings of the fit that is to come; they determine how long this takes.
        progress: called after every step of the small fit.

    Returns:
        [N, H, W] bool, as large as the depths; nothing is found in photos that are never fitted.

    Raises:
        CaptureError: as ``fit`` does.
    """
    small = small_fit(settings, depths.known.shape[2])
    rows, frame = trained(len(reconstruction.paths)), frame_of(reconstruction.camera_to_world)
    if reconstruction.depths:  # a sensor also measures moving things
        (seen,) = pictures(reconstruction, frame, [depths.known.shape[2]])
        depths = confirmed(depths, seen, rows, small.threads)
    depths = replace(depths, likely=depths.known)  # whatever no other photo confirms may have moved
    fitting = Fitting(reconstruction, small, depths)
    seen, _ = fitting.level(0.0)
    still = torch.zeros_like(depths.known, dtype=torch.bool) if depths.moving is None else depths.moving
    moving = still.clone()
    steps = math.ceil(small.views / fitting.views)
    ends = [round(steps * (number + 1) / ROUNDS) for number in range(ROUNDS)]
    for step in range(steps):
        fitting.step(step, steps)
        progress("moving", step + 1, steps)
        if step + 1 in ends:
            last = step + 1 == steps
            found = compared(fitting, seen, reconstruction, moving, depths.known > 0)
            moving[rows] = still[rows] | (resized(found.things(last).float(), moving.shape[1:]) > 0)
            fitting.levels = {1.0: (seen, depths.without(moving).at(seen, rows))}
    return moving & ~still


def small_fit(settings: FitSettings, width: int) -> FitSettings:
    """Return the settings of the small fit to images of this width; nothing else of ``settings`` counts."""
    return replace(
        settings,
        width=width,
        cap=min(GAUSSIANS, settings.cap),
        views=max(1, round(settings.views * SHARE)),
        levels=((0.0, 1.0),),
        sh_degree=0,
        device="cpu",
    )


@dataclass(frozen=True)
class Comparison:
    """How photos differ from a fit, and what other photos show of the same places, at half the size.

    Attributes:
        known: [R, h, w] bool, whether other photos confirm the depth of a pixel.
        unlike: [R, h, w] float32, how much a photo differs from the fit, from 0 to 1, averaged over some pixels.
        agreeing: [R, h, w] int16, number of other photos that show the place that the fit shows there, and look like
            the fit.
        disagreeing: number of other photos that show that place, and look different.
        through: number of other photos that see through it.
    """

    known: Tensor
    unlike: Tensor
    agreeing: Tensor
    disagreeing: Tensor
    through: Tensor

    def things(self, strict: bool) -> Tensor:
        """Return the pixels of what moved, or without ``strict`` of what may have moved: [R, h, w] bool.

        Args:
            strict: whether to find only large and clear things, where other photos agree with the fit.
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
    """Compare the photos that a fit is trained on with its renders.

    Args:
        fitting: the fit.
        seen: its photos.
        reconstruction: their poses.
        ignored: [N, H, W] bool, pixels that do not count when exposures are estimated.
        known: [N, H, W] bool, whether other photos confirm the depth of a pixel; elsewhere a photo that looks like the
            fit has no vote, since the depth of the sky, for one, is unknown.
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
    signed = torch.where(unlike < SUSPECT, alike, -depth)  # positive where a photo looks like the fit
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
    """Return how a photo differs from a render, apart from a gain and an offset of each channel.

    Gain and offset are estimated from what is alike: the larger a difference is, the less it weighs.

    Args:
        drawn: [H, W, 3] in [0, 1], the render.
        photo: [H, W, 3] in [0, 1].
        ignored: [H, W] bool, pixels that do not count for gain and offset.

    Returns:
        [H, W]: the largest absolute difference of the channels, whose signed differences are averaged over some pixels.
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
    """Return which of ``count`` photos one of them is compared with."""
    others = [other for other in range(count) if abs(other - row) > APART]
    stride = max(1, -(-len(others) // ASKED))
    return others[row % stride :: stride]


def _rounded(pixels: Mask) -> Mask:
    """Fill the holes and gaps of a mask, and grow it by a pixel."""
    closed = ndimage.binary_closing(np.pad(pixels, 3, mode="edge"), np.ones((5, 5)))[3:-3, 3:-3]
    whole: Mask = ndimage.binary_dilation(ndimage.binary_fill_holes(closed))
    return whole
