"""The least time that a GPU needs for a frame: operations at the measured rate, bytes at the measured bandwidth.

Operations are counted as in bound.py, with one difference: ``exp2`` and ``log2`` are instructions here. What is
counted is what the kernel reports (``CudaRenderer.efforts``): candidates, those of them that show before the tile is
covered, and pairs of one and a cell of 4×2 pixels. Descending the tree, Gaussians that are tested and dropped,
sorting, finding cells and lanes outside a splat cost nothing in it, and a merged Gaussian counts as a plain one.

Bytes are counted as if every frame fetched them from memory. Frames of a batch look at one scene, so caches serve a
part of them, and a frame may take less than its bytes say; it cannot take less than its operations say.
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
"""Operations to test a Gaussian against the tile's edges (offset 3, depth 6, near plane 1, four edges 14 each), and for
its depth in double precision."""
CANDIDATE_BYTES = 16 + 4 + 2 * 8
"""Sphere and index, read; a key, written and read again."""
VISIBLE_BYTES = 8 + 48
"""Key and shape, read."""
COLOR_BYTES = 6
"""Per harmonic, as half floats."""
CELL_PIXELS = 8


def bound_us(
    machine: Machine, candidates: float, visible: float, blended: float, degree: int, pixels: int
) -> tuple[float, float]:
    """The least microseconds that an antialiased frame takes: for its operations, and for its bytes.

    Args:
        machine: what the device can do.
        candidates: Gaussians, of all tiles of the frame.
        visible: likewise.
        blended: pairs of a Gaussian and a cell.
        degree: of the spherical harmonics.
        pixels: in the image.
    """
    flops = candidates * CANDIDATE_FLOPS
    flops += visible * (PLAIN_FLOPS + SQUARE_FLOPS + ANTIALIASED_FLOPS - LOG2_FLOPS + 1 + color_flops(degree))
    flops += blended * CELL_PIXELS * (PIXEL_FLOPS - FALL_OFF_FLOPS + 1)
    size = candidates * CANDIDATE_BYTES + visible * (VISIBLE_BYTES + COLOR_BYTES * (degree + 1) ** 2) + 3 * pixels
    return 1e6 * flops / machine.flops, 1e6 * size / machine.memory_bandwidth
