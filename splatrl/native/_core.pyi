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

def first_bad_camera(
    camera_to_world: Tensor,  # [B, 4, 4] float32
    K: Tensor,  # [B, 3, 3] float32
) -> int:
    """The first row whose pose is not rigid or whose K is not a pinhole's; -1 where all are right."""

def camera_to_models(
    camera_to_world: Tensor,  # [B, 4, 4] float32
    model_to_world: Tensor,  # [B, M, 4, 4] float32
    out: Tensor,  # [B, M, 4, 4] float32
) -> None:
    """Write the pose of each row's camera in the frame of each of its parts, computed in double precision."""

def first_bad_part(
    models: Tensor,  # [B, M] int64, -1 for none
    model_to_world: Tensor,  # [B, M, 4, 4] float32
    count: int,  # of the models that there are
) -> int:
    """The first part, row by row, whose model does not exist or whose pose is not rigid; -1 where all are right."""

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

def find_distances(
    solid: NDArray[np.bool_],  # [X, Y, Z]
    resolution: float,  # metres
    distance: NDArray[np.float32],  # [X, Y, Z], written: metres between centres; infinite where nothing is solid
    threads: int,
) -> None:
    """The distance from every voxel to the nearest solid one, exact."""

def build_levels(
    means: Tensor,  # [N, 3] float32, metres, world frame
    axes: Tensor,  # [N, 3, 3] float32, Σ = A Aᵀ
    opacities: Tensor,  # [N] float32
    sh: Tensor,  # [N, (degree + 1)², 3] float32
    degree: int,
) -> dict[str, NDArray[np.float32] | NDArray[np.uint32]]:
    """The tree over a scene, with merged Gaussians in its inner nodes; ``renderers/lod.py`` describes the arrays."""

def pack_model(
    means: Tensor,  # [N, 3] float32, metres, the model's own frame
    axes: Tensor,  # [N, 3, 3] float32, Σ = A Aᵀ
    opacities: Tensor,  # [N] float32
    sh: Tensor,  # [N, (degree + 1)², 3] float32
    degree: int,
    levels: dict[str, NDArray[np.float32] | NDArray[np.uint32]] | None,  # those of build_levels; None draws exactly
    background: tuple[float, float, float],
    antialiased: bool,
) -> dict[str, NDArray[Any]]:
    """A model as a renderer of this background keeps it; ``renderers/packed.py`` describes the arrays.

    Raises:
        ValueError: for levels of other Gaussians.
    """

def flat_scene(
    packed: dict[str, NDArray[Any]],  # the arrays of pack_model, made for this background
    background: tuple[float, float, float],
    antialiased: bool,
    tolerance: float,  # pixels
) -> dict[str, Any]:
    """A model as ``cuda/render.cu`` reads it; ``cuda/tile.h`` describes the arrays.

    Raises:
        ValueError: for arrays that are not those of ``pack_model``.
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

class Colliders:
    """A body in several grids, which the caller keeps. Queries are those of ``Collider``, and first take the address of
    [B] int64, which grid each row asks; one that does not exist is refused as a pose is."""

    def __init__(self, colliders: list[Collider]) -> None: ...
    def collides(self, places: int, poses: int, out: int, count: int, threads: int, /) -> int: ...
    def free_fraction(self, places: int, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...
    def sweeps(self, places: int, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...
    def clearance(self, places: int, points: int, out: int, count: int, threads: int, /) -> int: ...

class RayCaster:
    """Casts beams against a grid of voxels; poses and beams must be finite, and beams unit vectors."""

    def __init__(
        self,
        room: NDArray[np.uint8],  # [Z, X, Y], see ``splatrl.collision.rays.room_around``
        corner: tuple[float, ...],  # of the grid, metres
        resolution: float,  # metres
    ) -> None: ...
    def ranges(
        self,
        poses: int,  # addresses of [B, 4, 4] float32
        beams: int,  # [R, 3] float32, in the frames of the poses
        out: int,  # [B, R] float32, metres
        count: int,
        along: int,
        reach: float,
        threads: int,
        /,
    ) -> int:
        """Returns -1, or the first row that is not a rigid pose."""

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

    def put_model(
        self,
        model: int,
        arrays: dict[str, NDArray[Any]] | None,  # those of pack_model, made for this background; None for no model
    ) -> None:
        """Let a model be another one, or none. Not while another thread draws.

        Raises:
            ValueError: for arrays that are not those of ``pack_model``.
        """

    def needs(
        self,
        bounds: NDArray[np.float32],  # [N, 6], those of the roots of models in one frame
        errors: NDArray[np.float32],  # [N], metres, the largest of the nodes that end the tops of their trees
        camera_to_models: Tensor,  # [B, 4, 4] float32
        K: Tensor,  # [B, 3, 3] float32
        width: int,
        height: int,
        out: NDArray[np.uint8],  # [B, N], written: 0 for nothing, 1 for the top of its tree, 2 for the whole model
    ) -> None:
        """What cameras need to have of models that they may see."""

    def render(
        self,
        models: Tensor | None,  # [B, M] int64, -1 for none; None draws model 0, M = 1
        camera_to_models: Tensor,  # [B, M, 4, 4] float32, each in the frame of its model
        K: Tensor,  # [B, 3, 3] float32
        rgb: Tensor,  # [B, H, W, 3] float32, written
        depth: Tensor,  # [B, H, W] float32, written
        alpha: Tensor,  # [B, H, W] float32, written
        threads: int,
    ) -> None: ...
    def pixels(
        self,
        models: Tensor | None,  # [B, M] int64
        camera_to_models: Tensor,  # [B, M, 4, 4] float32
        K: Tensor,  # [B, 3, 3] float32
        pixels: Tensor,  # [B, H, W, 3] uint8, written
        efforts: Tensor | None,  # [B, 6] float32, written: the fields of renderers.Effort
        threads: int,
    ) -> None: ...

class Fitter:
    """Draws views of Gaussians that are being fitted, and pulls slopes back to their parameters.

    ``values`` are [R, C] float32, aligned to 64 bytes, C a multiple of 16: means, log-scales, quaternions (wxyz, of
    any length), opacity logits and harmonics by coefficient and colour; R is 14, 23, 38 or 59, of degree 0 to 3. The
    first ``count`` columns are drawn, antialiased, on black, unless nearer than ``near`` (at least 0.01). Each view is
    the work of one thread: results do not depend on ``threads``. Not for several threads at once.
    """

    def __init__(self) -> None: ...
    def render(
        self,
        values: Tensor,
        count: int,
        near: float,
        camera_to_world: Tensor,  # [V, 4, 4] float32
        K: Tensor,  # [V, 3, 3] float32
        known: Tensor,  # [V, H, W] float32, inverse depths, 0 where unknown
        rgb: Tensor,  # [V, H, W, 3] float32, written, not clamped
        agreement: Tensor,  # [V, H, W] float32, written: the sum of max(0, 1 - |depth · known - 1|) by their shares
        alpha: Tensor,  # [V, H, W] float32, written
        threads: int,
    ) -> None: ...
    def pull(
        self,
        values: Tensor,
        count: int,
        near: float,
        camera_to_world: Tensor,  # [V, 4, 4] float32
        K: Tensor,  # [V, 3, 3] float32
        known: Tensor,  # [V, H, W] float32, as above
        slopes: Tensor,  # [V, H, W, 5] float32, by red, green, blue, agreement and alpha as above
        gradients: Tensor,  # [V, R, C] float32, written up to count
        pose_slopes: Tensor,  # [V, 6] float32, written: by a turn of the camera in its place, a shift; world axes
        threads: int,
    ) -> None: ...
    def compare(
        self,
        values: Tensor,
        count: int,
        near: float,
        camera_to_world: Tensor,  # [V, 4, 4] float32
        K: Tensor,  # [V, 3, 3] float32
        pixels: Tensor,  # [N, H, W, 3] uint8
        known: Tensor,  # [N, H, W] float32, inverse depths, 0 where unknown
        chosen: Tensor,  # [V] int64, which of the photos each view is compared with
        exposure: Tensor,  # [N, 3, 2] float32, gain and offset of each channel
        ssim_weight: float,
        depth_weight: float,
        gradients: Tensor,  # [V, R, C] float32, written up to count
        losses: Tensor,  # [V, 16] float32, written: total, L1, SSIM, depth, slopes by exposure and pose
        threads: int,
    ) -> None:
        """Compare views with photos by (1 - w) L1 + w (1 - SSIM) + the depth weight times (1 - agreement)."""

    def update(
        self,
        values: Tensor,
        gradients: Tensor,  # [V, R, C] float32, of which the mean is taken
        first: Tensor,  # [R, C] float32, moments, written
        second: Tensor,  # [R, C] float32, written
        rates: Tensor,  # [R] float32
        step: int,  # from 1
        beta1: float,
        beta2: float,
        epsilon: float,
        opacity_slope: float,  # of each opacity
        scale_slope: float,  # of each standard deviation
        noise: float,  # times the covariance, for the transparent
        seed: int,
        threads: int,
    ) -> None:
        """One step of Adam on ``values``, with regularisers and noise."""

def sweep(
    grey: Tensor,  # [N, H, W] float32, photos
    camera_to_world: Tensor,  # [N, 4, 4] float32
    K: Tensor,  # [3, 3] float32
    rows: Tensor,  # [R] int64, the photos whose depth is wanted
    neighbours: Tensor,  # [R, M] int64, the photos that each is compared with; -1 ends a line
    ranges: Tensor,  # [R, 2] float32, smallest and largest inverse depth
    soundings: Tensor,  # [S, 3] float32, photo by photo: column, row, inverse depth of places that are known
    firsts: Tensor,  # [N + 1] int64, where those of each photo begin
    depths: int,  # how many inverse depths are tried, a multiple of 16
    out: Tensor,  # [N, H, W] float32, inverse depths; written where a photo has neighbours
    threads: int,
) -> None:
    """Inverse depths of photos by plane sweep (5×5 correlation, the best three neighbours) and semi-global matching.

    Raises:
        ValueError: for a photo that is not there, or a number of depths that cannot be.
    """

def agree(
    inverse: Tensor,  # [N, H, W] float32, inverse depths, 0 where there is none
    camera_to_world: Tensor,  # [N, 4, 4] float32
    K: Tensor,  # [3, 3] float32
    rows: Tensor,  # [R] int64
    neighbours: Tensor,  # [R, M] int64, the photos that are asked; -1 ends a line
    tolerance: float,  # share of the depth
    least: int,  # of the neighbours that must agree
    out: Tensor,  # [N, H, W] float32, written in ``rows``: the mean with those that agree, 0 where too few do
    threads: int,
) -> None:
    """What other photos confirm of the depths of photos."""

def pool_images(
    images: int,  # address of [N, H, W, C] uint8
    shape: tuple[int, int, int, int],
    side: int,  # of a cell, pixels
    out: int,  # address of [N, H // side, W // side, C] float32, written
    /,
) -> None:
    """Average images over square cells, in [−0.5, 0.5]; both are C-contiguous memory.

    Raises:
        ValueError: for a side that is not from 1 to 4096.
    """

def change_appearance(
    pixels: Tensor,  # [B, H, W, 3] uint8
    weights: Tensor,  # [B, K] float32, of a blur: of a pixel itself, and of those 1, 2, ... to both sides
    gain: Tensor,  # [B, 3] float32, of each colour
    offset: Tensor,  # [B, 3] float32, added to it, of 255
    grain: Tensor,  # [B] float32, standard deviation of the noise, of 255
    noise: Tensor | None,  # [B, H, 3 W] float32, of standard deviation 1
    out: Tensor,  # [B, H, W, 3] uint8, written
    threads: int,
) -> None:
    """Blur images, change their colours and add noise.

    Raises:
        ValueError: for tensors whose sizes do not belong together.
    """

def put_into_weather(
    pixels: Tensor,  # [B, H, W, 3] uint8
    tint: Tensor,  # [B, 3] float32, gains of the light
    veil: Tensor,  # [B, 3] float32, colour of the fog
    left: Tensor | None,  # [B, H, W] float32, share of the light that the fog leaves; None where there is none
    far: Tensor | None,  # [B, H, W] float32, metres; None where it is not known
    falling: tuple[Tensor, ...] | None,  # of ``Falling`` in weather_images.py
    lens: tuple[Tensor, ...] | None,  # of ``Wet``
    out: Tensor,  # [B, H, W, 3] uint8, written
    threads: int,
) -> None:
    """Put images into weather.

    Raises:
        ValueError: for tensors whose sizes do not belong together.
    """

def trunk_forward(
    shape: tuple[int, ...],  # height, width and channels of images; channels of two convolutions; features
    images: int,  # address of [count, height, width, channels]
    count: int,
    weights: tuple[int, ...],  # addresses of weights and bias of each layer, in PyTorch's order
    layers: tuple[int, ...],  # addresses of [count, rows, columns, channels] twice and [count, features], written
    threads: int,
    /,
) -> None:
    """Two convolutions without padding, of 4 and 3 pixels at a stride of 2, and a dense layer, each with a ReLU.

    Addresses are those of C-contiguous float32 in main memory.

    Raises:
        ValueError: for images of less than 8 pixels a side, or channels of convolutions in other than sixteens.
    """

def trunk_backward(
    shape: tuple[int, ...],
    images: int,
    count: int,
    weights: tuple[int, ...],
    layers: tuple[int, ...],  # as ``trunk_forward`` wrote them
    slopes: int,  # address of [count, features], of the features
    gradients: tuple[int, ...],  # addresses of what is written, in the order and shapes of the weights
    threads: int,
    /,
) -> None:
    """The gradients of the weights."""

def policy_loss(
    frames: tuple[int, ...],  # addresses of hidden, action (int64), log_prob, advantage and value_target, [count, ...]
    sizes: tuple[int, int, int],  # count, features, actions
    heads: tuple[int, ...],  # addresses of weights and bias of the policy's and of the value's linear layer
    clip_epsilon: float,
    critic_coeff: float,
    entropy_coeff: float,
    gradients: tuple[int, ...],  # addresses of what is written: those of the heads, and of hidden
    statistics: int,  # address of [5], written: ``splatrl.training.loss.STATISTICS``
    /,
) -> None:
    """The gradients of the loss of proximal policy optimisation over discrete actions.

    Addresses are those of C-contiguous float32 in main memory.

    Raises:
        ValueError: for an action that is not one of them.
    """

def adam(
    tensors: list[tuple[int, ...]],  # addresses of values, gradient, first and second moment of each
    counts: list[int],  # numbers in each
    step: float,  # from 1
    rate: float,
    beta1: float,
    beta2: float,
    epsilon: float,
    max_norm: float,
    /,
) -> None:
    """Clip gradients to a norm, all tensors together, and take a step of Adam."""

class StepTable:
    """Steps on a lattice, by state and action; states are numbered in C order.

    Args:
        shape: number of values of each index of a state.
        next: numbers of the states after a step.
        free_fraction: see ``Move``.
        reward: see ``Verdict``, as ``terminated`` and ``outcome``.
        poses: of states, body to world.

    Raises:
        ValueError: for tables of other sizes, or a number that is no state's.
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        next: Tensor,  # [states, actions] int64
        free_fraction: Tensor,  # [states, actions] float32
        reward: Tensor,  # [states, actions] float32
        terminated: Tensor,  # [states, actions] bool
        outcome: Tensor,  # [states, actions] int64
        poses: Tensor,  # [states, 4, 4] float32
    ) -> None: ...
    def step(
        self,
        given: list[int],  # addresses of state [count, D], and action, step_count, episode_return, level, goals [count]
        found: list[int],  # of what is written: the same without action, then outcome, free_fraction, reward,
        # success, done, terminated, truncated and [count, 4, 4] poses
        count: int,
        max_steps: int,
        goals_for_success: int,
        progress: int,  # address of that of the curriculum, which is changed
        schedule: tuple[int, int, float],  # levels, window, threshold
        /,
    ) -> bool:
        """Look steps up, and count as ``SplatEnv`` does; false, and nothing is written, for what is not of the lattice.

        Addresses are those of C-contiguous memory with the types of the env.
        """

    def begin(
        self,
        old: list[int],  # addresses of state [count, D], and step_count, episode_return, level, goals, outcome,
        # free_fraction, success, done, terminated, truncated [count]
        found: list[int],  # of what is written: the same, and [some, 4, 4] poses
        count: int,
        rows: int,  # address of [some] int64, in which episodes begin
        some: int,
        uniform: int,  # address of [count] float64 in [0, 1), which draw the starts
        starts: int,  # address of [available, D] int64
        available: int,
        level: int,
        /,
    ) -> None:
        """Copy entries of which some rows are those of episodes that begin.

        Raises:
            ValueError: for a row that is not one of them, or a start that is not of the lattice.
        """

def with_rows(
    tensors: list[tuple[int, int, int, int]],  # addresses of old, fresh and written values, and bytes of the last
    rows: int,  # address of [some] int64
    some: int,
    count: int,  # rows of what is old and of what is written
    /,
) -> None:
    """Copy tensors of which some rows are those of others; all are C-contiguous memory.

    Raises:
        ValueError: for a row that is not one of them.
    """

class RowIndex:
    """Numbers rows of bytes, from 0 in the order in which they are added.

    Columns are given by address, bytes of a row, and bytes from one row to the next.
    """

    def __init__(self) -> None: ...
    def find(
        self,
        columns: list[tuple[int, int, int]],
        count: int,  # rows
        out: int,  # address of [count] int64, written: numbers, or −1 − i for a row like the i-th of what is returned
        /,
    ) -> list[int]:
        """The rows that have no number, each the first of those alike."""

    def add(self, columns: list[tuple[int, int, int]], rows: list[int], /) -> None:
        """Give rows that have none the next numbers."""

    def __len__(self) -> int: ...
