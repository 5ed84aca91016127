"""The C++ core. Arrays are C-contiguous CPU memory: torch tensors and numpy arrays both go in without a copy."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

def isa() -> str:
    """The instruction set that kernels run with: the fastest one, or the one that $SPLATRL_ISA names.

    Raises:
        ValueError: where $SPLATRL_ISA is not one of ``supported_isas()``.
    """

def supported_isas() -> list[str]:
    """The instruction sets that this processor can run, slowest first."""

def add_density(
    means: NDArray[np.float64],  # [N, 3], in voxels like all lengths here, from the corner of the grid
    axes: NDArray[np.float64],  # [N, 3, 3], columns: the unit axes of the Gaussian
    scales: NDArray[np.float64],  # [N, 3], standard deviations
    opacities: NDArray[np.float64],  # [N]
    first: NDArray[np.int64],  # [N, 3], the first voxel of the Gaussian's range
    end: NDArray[np.int64],  # [N, 3], one past the last voxel
    extent: float,  # standard deviations at which a Gaussian ends
    density: NDArray[np.float32],  # [X, Y, Z], written
) -> None:
    """Add opacity · exp(−½ d²) to the voxels in reach, d from the mean to the box around the voxel along the axes."""

def build_levels(
    means: Tensor,  # [N, 3] float32, metres, world frame
    axes: Tensor,  # [N, 3, 3] float32, Σ = A Aᵀ
    opacities: Tensor,  # [N] float32
    sh: Tensor,  # [N, (degree + 1)², 3] float32
    degree: int,
) -> dict[str, NDArray[np.float32] | NDArray[np.uint32]]:
    """The tree over a scene, with merged Gaussians in its inner nodes; ``renderers/lod.py`` describes the arrays."""

def flat_scene(
    means: Tensor,  # [N, 3] float32, metres, world frame
    axes: Tensor,  # [N, 3, 3] float32, Σ = A Aᵀ
    opacities: Tensor,  # [N] float32
    sh: Tensor,  # [N, (degree + 1)², 3] float32
    degree: int,
    background: tuple[float, float, float],
    levels: dict[str, NDArray[np.float32] | NDArray[np.uint32]] | None,  # those of build_levels; None draws exactly
    antialiased: bool,
    tolerance: float,  # pixels
    first_slot: int,  # where the scene begins in the arrays of several, a multiple of 16
    first_cluster: int,
) -> dict[str, Any]:
    """The scene as ``cuda/render.cu`` reads it; ``cuda/tile.h`` describes the arrays.

    Raises:
        ValueError: for levels of other Gaussians.
    """

class Collider:
    """A body in a grid of voxels. Queries take the addresses of C-contiguous CPU memory and write to ``out``; they
    return -1, or the first row that is not finite or not a rigid pose."""

    def __init__(
        self,
        solid: NDArray[np.bool_],  # [X, Y, Z]
        distance: NDArray[np.float32],  # [X, Y, Z], metres between the centres of a voxel and the nearest solid one
        corner: tuple[float, ...],  # of the grid, metres
        resolution: float,  # metres
        half: tuple[float, float, float],  # of a box, metres
        half_length: float,  # of a capsule's cylinder, metres
        radius: float,  # of a sphere or capsule, metres; 0 for a box
    ) -> None: ...
    @property
    def bits(self) -> NDArray[np.uint64]:
        """[X, Y, words]: bit z of a column is the voxel (x, y, z). Read only, like ``distance``."""
    @property
    def distance(self) -> NDArray[np.uint16]:
        """[X, Y, Z]: from each voxel to the nearest solid one, in 1/256 of a voxel."""
    @property
    def shape(self) -> tuple[float, float, float, float, float, float, float]:
        """The body, grown to count touches: half extents, half length, radius, inner and outer radius, voxels."""
    def collides(self, poses: int, out: int, count: int, threads: int, /) -> int: ...  # [B, 4, 4] float32 -> bool
    def free_fraction(self, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...  # -> float32
    def sweeps(self, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...  # -> bool
    def clearance(self, points: int, out: int, count: int, threads: int, /) -> int: ...  # [B, 3] float32 -> float32

class Renderer:
    """Renders into memory that the caller provides; its inputs must be finite."""

    def __init__(
        self,
        antialiased: bool,
        background: tuple[float, float, float],
        tolerance: float,  # pixels
    ) -> None: ...
    def add_model(
        self,
        means: Tensor,  # [N, 3] float32, metres, the model's own frame
        axes: Tensor,  # [N, 3, 3] float32, columns: the axes of the Gaussian times its standard deviations
        opacities: Tensor,  # [N] float32
        sh: Tensor,  # [N, (degree + 1)², 3] float32
        degree: int,
        levels: dict[str, NDArray[np.float32] | NDArray[np.uint32]] | None,  # those of build_levels; None draws exactly
    ) -> None:
        """Add a model; the first is model 0.

        Raises:
            ValueError: for levels of other Gaussians.
        """

    def render(
        self,
        models: Tensor | None,  # [B, M] int64, -1 for none; None draws model 0, M = 1
        camera_to_models: Tensor,  # [B, M, 4, 4] float32, each in the frame of its model
        K: Tensor,  # [B, 3, 3] float32
        rgb: Tensor,  # [B, H, W, 3] float32, written
        depth: Tensor,  # [B, H, W] float32, written
        alpha: Tensor,  # [B, H, W] float32, written
        efforts: Tensor,  # [B, 6] float32, written: the fields of renderers.Effort
        threads: int,
    ) -> None: ...
    def pixels(
        self,
        models: Tensor | None,  # [B, M] int64
        camera_to_models: Tensor,  # [B, M, 4, 4] float32
        K: Tensor,  # [B, 3, 3] float32
        pixels: Tensor,  # [B, H, W, 3] uint8, written
        efforts: Tensor,  # [B, 6] float32, written
        threads: int,
    ) -> None: ...
