"""The C++ core. Arrays are C-contiguous CPU memory: torch tensors and numpy arrays both go in without a copy."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

def isa() -> str:
    """The instruction set that kernels run with: the fastest one, or the one that $SPLATRL_ISA names.

    Raises:
        ValueError: where $SPLATRL_ISA names none of ``supported_isas()``.
    """

def supported_isas() -> list[str]:
    """The instruction sets that this processor can run, slowest first."""

def add_density(
    means: NDArray[np.float64],  # [N, 3], lengths are in voxels, from the corner of the grid
    axes: NDArray[np.float64],  # [N, 3, 3], columns: the unit axes of the Gaussian
    scales: NDArray[np.float64],  # [N, 3], standard deviations
    opacities: NDArray[np.float64],  # [N]
    first: NDArray[np.int64],  # [N, 3], the first voxel of the Gaussian's range
    end: NDArray[np.int64],  # [N, 3], the first one behind it
    extent: float,  # standard deviations at which a Gaussian ends
    density: NDArray[np.float32],  # [X, Y, Z], written
) -> None:
    """Add opacity · exp(−½ d²) to the voxels in reach, d from the mean to the box along the axes around the voxel."""

def build_levels(
    means: Tensor,  # [N, 3] float32, metres, world frame
    axes: Tensor,  # [N, 3, 3] float32, Σ = A Aᵀ
    opacities: Tensor,  # [N] float32
    sh: Tensor,  # [N, (degree + 1)², 3] float32
    degree: int,
) -> dict[str, NDArray[np.float32] | NDArray[np.uint32]]:
    """The tree over a scene with merged Gaussians in its inner nodes; ``renderers/lod.py`` says what the arrays are."""

class Renderer:
    """Renders into memory that the caller gives; what goes in is finite."""

    def __init__(
        self,
        means: Tensor,  # [N, 3] float32, metres, world frame
        axes: Tensor,  # [N, 3, 3] float32, columns: the axes of the Gaussian times its standard deviations
        opacities: Tensor,  # [N] float32
        sh: Tensor,  # [N, (degree + 1)², 3] float32
        degree: int,
        antialiased: bool,
        background: tuple[float, float, float],
        levels: dict[str, NDArray[np.float32] | NDArray[np.uint32]] | None,  # those of build_levels; None draws exactly
        tolerance: float,  # pixels
    ) -> None:
        """
        Raises:
            ValueError: for levels that are not of these Gaussians.
        """

    def render(
        self,
        camera_to_world: Tensor,  # [B, 4, 4] float32
        K: Tensor,  # [B, 3, 3] float32
        rgb: Tensor,  # [B, H, W, 3] float32, written
        depth: Tensor,  # [B, H, W] float32, written
        alpha: Tensor,  # [B, H, W] float32, written
        efforts: Tensor,  # [B, 6] float32, written: the fields of renderers.Effort
        threads: int,
    ) -> None: ...
    def pixels(
        self,
        camera_to_world: Tensor,  # [B, 4, 4] float32
        K: Tensor,  # [B, 3, 3] float32
        pixels: Tensor,  # [B, H, W, 3] uint8, written
        efforts: Tensor,  # [B, 6] float32, written
        threads: int,
    ) -> None: ...
