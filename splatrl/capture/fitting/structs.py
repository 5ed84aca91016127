"""Constants and structures that the fit's kernels (``cuda/fit.cu``) share with the code that launches them."""

import ctypes

TILE = 16
"""Width and height of a tile, pixels; FIT_TILE of cuda/fit_views.h."""
THREADS = TILE * TILE
BLEND_BYTES, COMPARE_BYTES, BACK_BYTES, PULL_BYTES = 16_448, 14_624, 48_384, 192
"""Shared memory, bytes, of a block that blends a tile, compares it, backpropagates through the blending, and
backpropagates to the Gaussians."""
CHANNELS, PAIR_MOMENTS, SUMS, SPLAT_FLOATS = 5, 10, 5, 16
"""FIT_CHANNELS of fit_kernel.h, FIT_PAIR_MOMENTS of cuda/fit_slopes.h, FIT_SUMS of cuda/fit_compare.h, and the floats
of a FitSplat."""
ROWS = (14, 23, 38, 59)
"""Number of parameter rows for harmonics of degree 0 to 3."""


def kernel_defines(sh_degree: int) -> dict[str, int]:
    """Return the macros that ``cuda/fit.cu`` is compiled with."""
    return {
        "SH_DEGREE": sh_degree,
        "BLEND_BYTES": BLEND_BYTES,
        "COMPARE_BYTES": COMPARE_BYTES,
        "BACK_BYTES": BACK_BYTES,
        "PULL_BYTES": PULL_BYTES,
    }


class FitModel(ctypes.Structure):
    """Mirrors the structure of the same name in fit_kernel.h."""

    _fields_ = (
        ("values", ctypes.c_void_p),
        ("stride", ctypes.c_size_t),
        ("count", ctypes.c_uint32),
        ("degree", ctypes.c_int),
        ("near", ctypes.c_float),
    )


class FitViews(ctypes.Structure):
    """Mirrors the structure of the same name in cuda/fit_views.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("camera_to_world", "K", "photos", "known")),
        *((name, ctypes.c_int) for name in ("views", "width", "height")),
    )


class FitPairs(ctypes.Structure):
    """Mirrors the structure of the same name in cuda/fit_views.h."""

    _fields_ = tuple(
        (name, ctypes.c_void_p)
        for name in ("splats", "counts", "ends", "keys", "owners", "order", "starts", "taken")
    )  # fmt: skip


class FitPhotos(ctypes.Structure):
    """Mirrors the structure of the same name in cuda/fit_compare.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("pixels", "exposure", "image", "curves", "slopes", "sums")),
        *((name, ctypes.c_float) for name in ("ssim_weight", "depth_weight")),
    )


class FitUpdate(ctypes.Structure):
    """Mirrors the structure of the same name in fit_kernel.h."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("values", "gradients")),
        ("views", ctypes.c_size_t),
        *((name, ctypes.c_void_p) for name in ("first", "second", "rates")),
        *((name, ctypes.c_size_t) for name in ("rows", "stride")),
        *((name, ctypes.c_float) for name in ("beta1", "beta2", "epsilon", "correction1", "correction2")),
        *((name, ctypes.c_float) for name in ("opacity_slope", "scale_slope", "noise")),
        ("seed", ctypes.c_uint64),
    )
