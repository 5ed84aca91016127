"""Depth of what photos show: measured by a sensor, and elsewhere found by comparing neighbouring photos.

Photos are compared by plane sweep (Collins 1996): among many depths, each pixel takes the one at which its neighbours
show the same, smoothed along four directions (semi-global matching, Hirschmüller 2008). Depths that other photos
confirm count as known.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.fitting.pictures import Frame, Pictures, pictures
from splatrl.capture.progress import Progress, silent
from splatrl.images import read_grey
from splatrl.native import _core
from splatrl.native.threads import usable_cores

WIDTH = 160
"""Width of the photos that are compared, pixels."""
LEVELS = 64
"""Number of inverse depths that are tried."""
REACH = (0.6, 1.5)
"""Factors that turn the smallest and largest inverse depth of the points that a photo shows into the range to try."""
COMPARED, WITNESSES = 6, 12
"""Number of neighbours that a photo is compared with, and of neighbours whose depths may confirm its own."""
CONFIRMED, TOLERANCE = 3, 0.05
"""Minimum number of neighbours that must agree, and the relative tolerance in depth."""
APART = 0.1
"""Distance to the best neighbours, relative to the median depth."""
TURNED = 0.8
"""Minimum cosine between the optical axes of neighbours."""
FEWEST = 10
"""Minimum number of points that a photo must show to get a range of depths."""
AT_ONCE = 16
"""Number of photos between two reports of progress."""
IGNORED = -1.0
"""Stands in place of an inverse depth for pixels that are not compared."""


@dataclass(frozen=True)
class Depths:
    """What is known of the depth of N photos, in the frame of the fit.

    Attributes:
        likely: [N, H, W] float32 inverse depths, the best guess; 0 where there is none.
        known: [N, H, W] float32 inverse depths that a sensor measured or other photos confirm; 0 elsewhere.
        moving: [N, H, W] bool, where photos show what a fit leaves out: moving things, and what never changes; None
            where unknown.
    """

    likely: Tensor
    known: Tensor
    moving: Tensor | None = None

    def far(self, frame: Frame) -> Tensor:
        """Return ``known`` as depths in the unit of the reconstruction, 0 where unknown: [N, H, W]."""
        return torch.where(self.known > 0, frame.extent / self.known.clamp_min(1e-12), 0.0)

    def without(self, moving: Tensor) -> "Depths":
        """Return the depths without these pixels, too, given as [N, H, W] bool."""
        moving = moving if self.moving is None else moving | self.moving
        likely, known = (torch.where(moving, 0.0, inverse) for inverse in (self.likely, self.known))
        return Depths(likely, known, moving)

    def at(self, seen: Pictures, rows: Tensor) -> Tensor:
        """Return the known inverse depths of these photos at another size, points that they saw included: [N, H, W].

        Pixels that are left out are ``IGNORED``.
        """
        size = seen.pixels.shape[1:3]
        out = resized(self.known, size)
        for row in rows.tolist():
            x, y, inverse = seen.soundings[seen.firsts[row] : seen.firsts[row + 1]].unbind(1)
            column, line = x.long().clamp(0, size[1] - 1), y.long().clamp(0, size[0] - 1)
            free = out[row, line, column] == 0
            out[row, line[free], column[free]] = inverse[free]
        if self.moving is not None:
            out[resized(self.moving.float(), size) > 0] = IGNORED
        return out


def resized(values: Tensor, size: torch.Size) -> Tensor:
    """Resize values [N, h, w] float32 to a size [H, W] by nearest neighbour."""
    return torch.nn.functional.interpolate(values[:, None], size=size, mode="nearest-exact")[:, 0].contiguous()


def find_depths(
    reconstruction: Reconstruction,
    frame: Frame,
    rows: Tensor,
    threads: int | None = None,
    progress: Progress = silent,
) -> Depths:
    """Find the depths of the photos' pixels.

    Args:
        reconstruction: photos with poses; a sensor's depths are taken where it has any. A sensor reaches a few metres
            only, and sees nothing of what is black or glossy.
        frame: frame of the fit.
        rows: [R] int64, indices of the photos that may be used.
        threads: number of threads; None takes all cores that this process may use. The result does not depend on it.
        progress: called after every batch of photos.

    Raises:
        CaptureError: for a depth image that cannot be read.
    """
    (seen,) = pictures(reconstruction, frame, [min(WIDTH, reconstruction.width)])
    grey = seen.pixels.float().mean(-1) / 255
    places = seen.camera_to_world.contiguous(), seen.K.contiguous()
    ranges = torch.zeros(len(rows), 2)
    for line, row in enumerate(rows.tolist()):
        inverse = seen.soundings[seen.firsts[row] : seen.firsts[row + 1], 2]
        if len(inverse) >= FEWEST:
            ranges[line] = inverse.quantile(torch.tensor([0.02, 0.98])) * torch.tensor(REACH)
    likely, compared = torch.zeros_like(grey), witnesses_of(seen, rows)[:, :COMPARED].contiguous()
    cores = threads or usable_cores()
    for first in range(0, len(rows), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        _core.sweep(
            grey, *places, rows[some], compared[some], ranges[some], seen.soundings, seen.firsts, LEVELS, likely, cores
        )
        progress("depth", min(first + AT_ONCE, len(rows)), len(rows))
    found = confirmed(Depths(likely, likely), seen, rows, cores)
    if not reconstruction.depths:
        return found
    sensed = measured(reconstruction, frame, rows)
    return Depths(*(torch.where(sensed > 0, sensed, inverse) for inverse in (found.likely, found.known)))


def confirmed(depths: Depths, seen: Pictures, rows: Tensor, threads: int | None = None) -> Depths:
    """Return the depths with only those as known that the depths of other photos confirm.

    Args:
        depths: depths of the photos' pixels.
        seen: the photos, as large as the depths.
        rows: [R] int64, indices of the photos that may be used; nothing is known of others.
        threads: number of threads; None takes all cores that this process may use. The result does not depend on it.
    """
    places, known = (seen.camera_to_world.contiguous(), seen.K.contiguous()), torch.zeros_like(depths.likely)
    cores, witnesses = threads or usable_cores(), witnesses_of(seen, rows)
    _core.agree(depths.likely, *places, rows, witnesses, TOLERANCE, CONFIRMED, known, cores)
    return replace(depths, known=known)


def witnesses_of(seen: Pictures, rows: Tensor) -> Tensor:
    """Return the photos that see the same as each of ``rows``: [R, WITNESSES] int64, padded with −1."""
    neighbours = torch.full((len(rows), WITNESSES), -1)
    for line, row in enumerate(rows.tolist()):
        inverse = seen.soundings[seen.firsts[row] : seen.firsts[row + 1], 2]
        if len(inverse) >= FEWEST:
            others = neighbours_of(seen, row, rows, float((1 / inverse).median()))
            neighbours[line, : len(others)] = others
    return neighbours


def neighbours_of(seen: Pictures, row: int, rows: Tensor, depth: float) -> Tensor:
    """Return up to ``WITNESSES`` of the views ``rows`` that see the same from a little to the side: [n] int64."""
    poses = seen.camera_to_world
    others = rows[(rows != row) & (poses[rows, :3, 2] @ poses[row, :3, 2] > TURNED)]
    distance = (poses[others, :3, 3] - poses[row, :3, 3]).norm(dim=1).clamp_min(1e-6)
    return others[(distance / (APART * depth)).log().abs().argsort(stable=True)[:WITNESSES]]


def measured(reconstruction: Reconstruction, frame: Frame, rows: Tensor) -> Tensor:
    """Return the inverse depths of a sensor, at the size at which photos are compared: [N, H, W], 0 where it has none.

    Args:
        reconstruction: photos with poses and depth images.
        frame: the frame of the fit.
        rows: [R] int64, the photos whose depths are read; nothing is known of the others.

    Raises:
        CaptureError: for a depth image that cannot be read.
    """
    width = min(WIDTH, reconstruction.width)
    height = max(1, round(reconstruction.height * width / reconstruction.width))
    known = torch.zeros(len(reconstruction.paths), height, width)
    unit = reconstruction.depth_unit / frame.extent
    for row in rows.tolist():
        path = reconstruction.depths[row]
        try:
            every = read_grey(path)
        except (OSError, ValueError) as error:
            raise CaptureError(f"{path}: expected a depth image, uint16 PNG: {error}") from error
        lines = ((np.arange(height) + 0.5) * every.shape[0] / height).astype(int)
        columns = ((np.arange(width) + 0.5) * every.shape[1] / width).astype(int)
        counts = every[lines[:, None], columns].astype(np.float64)
        known[row] = torch.from_numpy(np.where(counts > 0, 1.0 / np.maximum(counts * unit, 1e-12), 0.0)).float()
    return known
