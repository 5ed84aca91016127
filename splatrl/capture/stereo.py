"""How far away what photos show is: measured by a sensor, or found by comparing neighbouring photos.

Photos are compared by plane sweep (Collins 1996): of many depths, each pixel takes the one at which its neighbours show
the same, smoothed along four directions (semi-global matching, Hirschmüller 2008). What the depths of other photos
confirm counts as known.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.fit_pictures import Frame, Pictures, pictures
from splatrl.capture.progress import Progress, silent
from splatrl.images import read_grey
from splatrl.native import _core
from splatrl.native.threads import usable_cores

WIDTH = 160
"""Of the photos that are compared, pixels."""
LEVELS = 64
"""Inverse depths that are tried."""
REACH = (0.6, 1.5)
"""Range of these, in the smallest and largest inverse depth of the points that a photo shows."""
COMPARED, WITNESSES = 6, 12
"""Neighbours that a photo is compared with; and whose depths are asked to confirm its own."""
CONFIRMED, TOLERANCE = 3, 0.05
"""So many of them must agree, to within this share of the depth."""
APART = 0.1
"""Distance to the best neighbours, in the median depth."""
TURNED = 0.8
"""Least cosine between the optical axes of neighbours."""
FEWEST = 10
"""Points that a photo must show, for a range of depths."""
AT_ONCE = 16
"""Photos between two words of progress."""


@dataclass(frozen=True)
class Depths:
    """What is known of the depth of N photos, in the frame of the fit.

    Attributes:
        likely: [N, H, W] float32 inverse depths, the best guess; 0 where there is none.
        known: [N, H, W] float32 inverse depths that a sensor measured or other photos confirm; 0 elsewhere.
    """

    likely: Tensor
    known: Tensor

    def far(self, frame: Frame) -> Tensor:
        """``known`` as depths in the unit of the reconstruction, 0 where unknown: [N, H, W]."""
        return torch.where(self.known > 0, frame.extent / self.known.clamp_min(1e-12), 0.0)

    def at(self, seen: Pictures, rows: Tensor) -> Tensor:
        """What is known of the pixels of these photos at another size, points that they saw included: [N, H, W]."""
        size = seen.pixels.shape[1:3]
        out = torch.nn.functional.interpolate(self.known[:, None], size=size, mode="nearest-exact")[:, 0].contiguous()
        for row in rows.tolist():
            x, y, inverse = seen.soundings[seen.firsts[row] : seen.firsts[row + 1]].unbind(1)
            column, line = x.long().clamp(0, size[1] - 1), y.long().clamp(0, size[0] - 1)
            free = out[row, line, column] == 0
            out[row, line[free], column[free]] = inverse[free]
        return out


def find_depths(
    reconstruction: Reconstruction,
    frame: Frame,
    rows: Tensor,
    threads: int | None = None,
    progress: Progress = silent,
) -> Depths:
    """Find how far away photos' pixels are.

    Args:
        reconstruction: photos with poses; where it has a sensor's depths, these are taken.
        frame: of the fit.
        rows: [R] int64, the photos that may be looked at.
        threads: None takes all cores that this process may use; the result does not depend on it.
        progress: told about photos.

    Raises:
        CaptureError: for a depth image that cannot be read.
    """
    if reconstruction.depths:
        return measured(reconstruction, frame, rows)
    (seen,) = pictures(reconstruction, frame, [min(WIDTH, reconstruction.width)])
    grey = seen.pixels.float().mean(-1) / 255
    places = seen.camera_to_world.contiguous(), seen.K.contiguous()
    neighbours, ranges = torch.full((len(rows), WITNESSES), -1), torch.zeros(len(rows), 2)
    for line, row in enumerate(rows.tolist()):
        inverse = seen.soundings[seen.firsts[row] : seen.firsts[row + 1], 2]
        if len(inverse) < FEWEST:
            continue
        ends = inverse.quantile(torch.tensor([0.02, 0.98]))
        ranges[line] = ends * torch.tensor(REACH)
        others = neighbours_of(seen, row, rows, float((1 / inverse).median()))
        neighbours[line, : len(others)] = others
    likely, known = torch.zeros_like(grey), torch.zeros_like(grey)
    compared = neighbours[:, :COMPARED].contiguous()
    cores = threads or usable_cores()
    for first in range(0, len(rows), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        _core.sweep(
            grey, *places, rows[some], compared[some], ranges[some], seen.soundings, seen.firsts, LEVELS, likely, cores
        )
        progress("depth", min(first + AT_ONCE, len(rows)), len(rows))
    _core.agree(likely, *places, rows, neighbours, TOLERANCE, CONFIRMED, known, cores)
    return Depths(likely, known)


def neighbours_of(seen: Pictures, row: int, rows: Tensor, depth: float) -> Tensor:
    """Up to ``WITNESSES`` of the views ``rows`` that see the same from a little to the side: [n] int64."""
    poses = seen.camera_to_world
    others = rows[(rows != row) & (poses[rows, :3, 2] @ poses[row, :3, 2] > TURNED)]
    distance = (poses[others, :3, 3] - poses[row, :3, 3]).norm(dim=1).clamp_min(1e-6)
    return others[(distance / (APART * depth)).log().abs().argsort(stable=True)[:WITNESSES]]


def measured(reconstruction: Reconstruction, frame: Frame, rows: Tensor) -> Depths:
    """The depths of a sensor, at the size at which photos would be compared."""
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
    return Depths(known, known)
