"""The least time that one core needs for a frame: its operations at the peak rate, its bytes at the full bandwidth.

Operations are counted in splatrl/native (splat.h, lanes.h, kernels/) as they are written: a fused multiply-add is two;
an addition, product, minimum, maximum, comparison or rounding of a float is one; so is a reciprocal or an inverse root,
for which a processor has an instruction of limited precision. ``exp2`` and ``log2`` are their polynomials. Integer
operations, conversions, choices by a mask and the constants of a camera are not counted; an operation in double
precision is two.

Both times are added, as if nothing overlapped; the results keep each, for readers who prefer the larger alone. The
operations cannot reach their bound: the peak is that of a program of nothing but fused multiply-adds, while half of the
operations here are unfused; culling, integer work, half floats and the work on lanes that turn out to be empty cost
nothing in it. Merged Gaussians (level of detail) are counted as plain ones, though they take ``MERGED_FLOPS`` more.
"""

from machine import Machine

EXP2_FLOPS = 11  # three to split off the integer, four fused multiply-adds
FALL_OFF_FLOPS = 8  # the same in blending with AVX-512: an instruction on each side of three fused multiply-adds
LOG2_FLOPS = 15  # ± 1, a quotient, its square, five fused multiply-adds

PLAIN_FLOPS = 147
"""Operations to project a Gaussian: offset 3, mean 15, inverse depth 2, slopes and scales 4, bounded slopes 4, Jacobian
times rotation 2 · 9, that times a triangle 2 · 9, minors 9, covariance 15, determinants 9, dilation 2, position 4,
factor 11, reach 7, first and last pixel 2 · 11, tests 4."""
SQUARE_FLOPS = 12
"""In addition, where the factor of the covariance has nine numbers."""
ANTIALIASED_FLOPS = 5 + LOG2_FLOPS
"""In addition: the opacity that keeps the energy of a small Gaussian."""
MERGED_FLOPS = 2 * (LOG2_FLOPS + EXP2_FLOPS) + 21
"""In addition, for a merged Gaussian in an antialiased image. Not in the bound, as merged ones are not reported."""

VISIBLE_FLOPS = 18 + 8 + 4
"""Operations for a visible Gaussian: its depth in double precision, nine operations, its first and last block, and the
constants of u and v."""
DIRECTION_FLOPS, BASIS_FLOPS = 10, (0, 3, 18, 49)
"""Operations for a colour above degree 0: the viewing direction; the basis functions of each degree."""

PIXEL_FLOPS = 4 + 2 + 4 + FALL_OFF_FLOPS + 2 + 2 + 1 + 6
"""Operations to blend at a pixel: u, v, exponent, fall-off, peak and invisibility, transmittance, whether it counts,
three colours."""
BLOCK_PIXELS = 16

GEOMETRY_BYTES = 40  # read per Gaussian
COLOR_BYTES = 6  # per harmonic, as half floats, read for visible Gaussians
SPLAT_BYTES = 32 + 8 + 8 + 8  # record, blocks, tie and key of a visible Gaussian, written and read again
SORT_BYTES = 8 * 2  # a key read and written, in each of two passes


def color_flops(degree: int) -> int:
    """Operations for the colour of a visible Gaussian; colours of degree 0 are final."""
    if degree == 0:
        return 0
    return DIRECTION_FLOPS + BASIS_FLOPS[degree] + 3 * 2 * (degree + 1) ** 2 + 6


def bound_ms(
    machine: Machine, projected: float, visible: float, blended: float, degree: int, antialiased: bool
) -> tuple[float, float]:
    """The least milliseconds of one core that a frame takes: for its operations, and for its bytes.

    The bytes of the scene come at the bandwidth of the last cache if all that a frame reads fits into it, otherwise at
    that of memory; what is written between the stages stays in the cache.

    Args:
        machine: what a core can do.
        projected: Gaussians.
        visible: Gaussians.
        blended: pairs of a Gaussian and a block of 4×4 pixels.
        degree: of the spherical harmonics.
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
