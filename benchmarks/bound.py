"""Lower bound on one core's time per frame: its operations at the peak rate, its bytes at the full bandwidth.

Operations are counted as they are written in splatrl/native (splat.h, lanes.h, kernels/). A fused multiply-add counts
as two. An addition, product, minimum, maximum, comparison or rounding of a float counts as one, and so does a
reciprocal or an inverse square root, for which processors have an instruction of limited precision. ``exp2`` and
``log2`` are counted as their polynomials, and an operation in double precision as two. Integer operations, conversions,
selections by a mask and the constants of a camera are not counted.

The bound is the sum of both times, as if nothing overlapped; the results also keep each, for readers who prefer the
larger alone. It cannot be reached: the peak rate is that of a program of nothing but fused multiply-adds, while half of
the operations here are unfused; and culling, integer work, half floats and lanes that turn out to be empty cost nothing
in it. Merged Gaussians (level of detail) count as plain ones, although they take ``MERGED_FLOPS`` more.
"""

from machine import Machine

EXP2_FLOPS = 11  # three to split off the integer part, four fused multiply-adds
FALL_OFF_FLOPS = 8  # exp2 in blending with AVX-512: three fused multiply-adds, one instruction before and one after
LOG2_FLOPS = 15  # ± 1, a quotient, its square, five fused multiply-adds

PLAIN_FLOPS = 147
"""Operations to project a Gaussian whose covariance is kept as a triangular factor: offset 3, mean 15, inverse depth 2,
slopes and scales 4, bounded slopes 4, Jacobian times rotation 2 · 9, that times the factor 2 · 9, minors 9,
covariance 15, determinants 9, dilation 2, position 4, factor of the inverse 11, reach 7, first and last pixel 2 · 11,
tests 4."""
SQUARE_FLOPS = 12
"""Additional operations where the factor of the covariance is a full 3×3 matrix."""
ANTIALIASED_FLOPS = 5 + LOG2_FLOPS
"""Additional operations of antialiased images, for the opacity that preserves the energy of a small Gaussian."""
MERGED_FLOPS = 2 * (LOG2_FLOPS + EXP2_FLOPS) + 21
"""Additional operations for a merged Gaussian in an antialiased image. The bound leaves them out, since the renderer
does not report how many Gaussians are merged."""

VISIBLE_FLOPS = 18 + 8 + 4
"""Operations for a visible Gaussian: its depth (nine operations in double precision), its first and last block, and the
constants of u and v."""
DIRECTION_FLOPS, BASIS_FLOPS = 10, (0, 3, 18, 49)
"""Operations for a colour above degree 0: for the viewing direction, and for the basis functions up to each degree."""

PIXEL_FLOPS = 4 + 2 + 4 + FALL_OFF_FLOPS + 2 + 2 + 1 + 6
"""Operations to blend a Gaussian into a pixel: u, v, exponent, fall-off, limit and visibility of alpha, transmittance,
test whether the pixel is finished, three colours."""
BLOCK_PIXELS = 16

GEOMETRY_BYTES = 40  # read per Gaussian
COLOR_BYTES = 6  # per harmonic, three half floats, read for visible Gaussians
SPLAT_BYTES = 32 + 8 + 8 + 8  # record, blocks, tie-breaker and key of a visible Gaussian, each written and read again
SORT_BYTES = 8 * 2  # a key, read and written in each of two passes


def color_flops(degree: int) -> int:
    """Return the operations for the colour of a visible Gaussian; colours of degree 0 need none."""
    if degree == 0:
        return 0
    return DIRECTION_FLOPS + BASIS_FLOPS[degree] + 3 * 2 * (degree + 1) ** 2 + 6


def bound_ms(
    machine: Machine, projected: float, visible: float, blended: float, degree: int, antialiased: bool
) -> tuple[float, float]:
    """Return the minimum milliseconds that one core needs for a frame: for its operations, and for its bytes.

    The scene is read at the bandwidth of the last-level cache if everything that a frame touches fits into it, and
    otherwise at that of memory; data passed between the stages stays in the cache.

    Args:
        machine: peak rates of a core.
        projected: number of projected Gaussians.
        visible: number of visible Gaussians.
        blended: number of pairs of a Gaussian and a block of 4×4 pixels.
        degree: degree of the spherical harmonics.
        antialiased: True for antialiased images, False for classic ones.
    """
    flops = projected * (PLAIN_FLOPS + ANTIALIASED_FLOPS * antialiased)
    flops += visible * (VISIBLE_FLOPS + color_flops(degree))
    flops += blended * BLOCK_PIXELS * PIXEL_FLOPS
    scene_bytes = projected * GEOMETRY_BYTES + visible * COLOR_BYTES * (degree + 1) ** 2
    between_bytes = visible * (2 * SPLAT_BYTES + 2 * SORT_BYTES)
    fits = scene_bytes + between_bytes <= machine.cache_bytes
    bandwidth = machine.cache_bandwidth if fits else machine.memory_bandwidth
    seconds = scene_bytes / bandwidth + between_bytes / machine.cache_bandwidth
    return 1e3 * flops / machine.flops, 1e3 * seconds
