"""Lower bound on a GPU's time per frame: operations at the measured rate, bytes at the measured bandwidth.

Operations are counted as in bound.py, except that ``exp2`` and ``log2`` are single instructions here. The counts are
those that the kernel reports (``CudaRenderer.efforts``): the candidates, those of them that are visible before the tile
is covered, and the pairs of a Gaussian and a cell of 4×2 pixels. Descending the tree, Gaussians that are tested and
dropped, sorting, finding cells, and lanes outside a splat cost nothing in the bound. A merged Gaussian counts as a
plain one.

Bytes are counted as if every frame fetched them from memory. Since the frames of a batch show one scene, caches serve
some of them, so a frame may take less than the bound of its bytes, but never less than that of its operations.
"""

from bound import (
    ANTIALIASED_FLOPS,
    FALL_OFF_FLOPS,
    LOG2_FLOPS,
    PIXEL_FLOPS,
    PLAIN_FLOPS,
    SQUARE_FLOPS,
    color_flops,
)
from gpu_device import Machine

CANDIDATE_FLOPS = 66 + 2 * 9
"""Operations to test a candidate against the tile's edges (offset 3, depth 6, near plane 1, four edges 14 each), and to
compute its depth in double precision."""
CANDIDATE_BYTES = 16 + 4 + 2 * 8
"""Bytes per candidate: bounding sphere and index, read; a key, written and read again."""
VISIBLE_BYTES = 8 + 48
"""Bytes per visible Gaussian: key and shape, read."""
COLOR_BYTES = 6
"""Bytes per harmonic: three half floats."""
CELL_PIXELS = 8


def bound_us(
    machine: Machine, candidates: float, visible: float, blended: float, degree: int, pixels: int
) -> tuple[float, float]:
    """Return the minimum microseconds of an antialiased frame: for its operations, and for its bytes.

    Args:
        machine: peak rates of the device.
        candidates: number of candidates, summed over the tiles of the frame.
        visible: number of visible candidates, likewise.
        blended: number of pairs of a Gaussian and a cell.
        degree: degree of the spherical harmonics.
        pixels: number of pixels in the image.
    """
    flops = candidates * CANDIDATE_FLOPS
    flops += visible * (PLAIN_FLOPS + SQUARE_FLOPS + ANTIALIASED_FLOPS - LOG2_FLOPS + 1 + color_flops(degree))
    flops += blended * CELL_PIXELS * (PIXEL_FLOPS - FALL_OFF_FLOPS + 1)
    size = candidates * CANDIDATE_BYTES + visible * (VISIBLE_BYTES + COLOR_BYTES * (degree + 1) ** 2) + 3 * pixels
    return 1e6 * flops / machine.flops, 1e6 * size / machine.memory_bandwidth
