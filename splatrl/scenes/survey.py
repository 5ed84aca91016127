"""Statistics of a splat file."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Bounds, robust_bounds

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_CELLS = 64
"""Cells along the diagonal of the robust bounds, for finding floaters."""
_PIECE = 0.01
"""Fraction of all Gaussians below which a connected piece counts as a floater."""


@dataclass(frozen=True)
class Survey:
    """Statistics of Gaussians, in their own frame and units.

    Attributes:
        count: number of Gaussians.
        sh_degree: degree of the spherical harmonics.
        extent: corners of the bounding box of all means.
        bounds: corners of the bounding box of the opaque Gaussians, without the outermost half per cent at each end.
        opacities: [5] opacities at ``QUANTILES``.
        scales: [5] longest standard deviation of a Gaussian at ``QUANTILES``.
        floaters: fraction of the Gaussians that are detached from the scene.
    """

    count: int
    sh_degree: int
    extent: Bounds
    bounds: Bounds
    opacities: tuple[float, ...]
    scales: tuple[float, ...]
    floaters: float

    def __str__(self) -> str:
        lower, upper = np.array(self.bounds)
        percent = "  ".join(f"{q:>8.0%}" for q in QUANTILES)
        rows = [
            f"gaussians   {self.count:,}, spherical harmonics of degree {self.sh_degree}",
            f"extent      {_box(self.extent)}",
            f"opaque      {_box(self.bounds)}: {' × '.join(f'{size:.3g}' for size in upper - lower)} units",
            f"floaters    {self.floaters:.1%} of the Gaussians are detached from the scene",
            f"quantiles   {percent}",
            f"  opacity   {'  '.join(f'{value:8.3f}' for value in self.opacities)}",
            f"  scale     {'  '.join(f'{value:8.3g}' for value in self.scales)}",
        ]
        return "\n".join(rows)


def survey(gaussians: Gaussians) -> Survey:
    """Count and measure Gaussians.

    Args:
        gaussians: Gaussians in any frame and unit.
    """
    means = gaussians.means.detach().double().cpu().numpy()
    lower, upper = means.min(0).tolist(), means.max(0).tolist()
    scales = gaussians.scales.detach().amax(1).double().cpu().numpy()
    return Survey(
        count=len(means),
        sh_degree=gaussians.sh_degree,
        extent=((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])),
        bounds=robust_bounds(gaussians),
        opacities=tuple(np.quantile(gaussians.opacities.detach().double().cpu().numpy(), QUANTILES).tolist()),
        scales=tuple(np.quantile(scales, QUANTILES).tolist()),
        floaters=float(floats(gaussians).mean()),
    )


def floats(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Return a mask of the Gaussians that are detached from the scene: [N].

    Means are sorted into cells of a 64th of the diagonal of the robust bounds. Gaussians farther outside these bounds
    than half the diagonal are floaters, and so are those in a 26-connected piece of cells with less than 1 % of all.

    Args:
        gaussians: Gaussians in any frame and unit.
    """
    means = gaussians.means.detach().double().cpu().numpy()
    lower, upper = np.array(robust_bounds(gaussians))
    diagonal = float(np.linalg.norm(upper - lower))
    if diagonal == 0.0:
        return (means != lower).any(1)
    near = ((means >= lower - 0.5 * diagonal) & (means <= upper + 0.5 * diagonal)).all(1)
    cells = np.floor((means[near] - lower + 0.5 * diagonal) / diagonal * _CELLS).astype(np.int64)
    grid = np.zeros(cells.max(0) + 1, bool)
    grid[tuple(cells.T)] = True
    labels, _ = ndimage.label(grid, np.ones((3, 3, 3)))
    label = labels[tuple(cells.T)]
    small = np.bincount(label) < _PIECE * len(means)
    result = ~near
    result[near] = small[label]
    return result


def _box(bounds: Bounds) -> str:
    return "  ".join(f"{axis} {low:.3g} to {high:.3g}" for axis, low, high in zip("xyz", *bounds, strict=True))
