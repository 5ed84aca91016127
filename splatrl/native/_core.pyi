"""The C++ core. Arrays are C-contiguous CPU memory: torch tensors and numpy arrays are both passed without a copy."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

def isa() -> str:
    """Return the instruction set that kernels run with: the fastest one, or the one that $SPLATRL_ISA names.

    Raises:
        ValueError: if $SPLATRL_ISA is not one of ``supported_isas()``.
    """

def supported_isas() -> list[str]:
    """Return the instruction sets that this processor can run, slowest first."""

def first_bad_camera(
    camera_to_world: Tensor,  # [B, 4, 4] float32
    K: Tensor,  # [B, 3, 3] float32
) -> int:
    """Return the first row whose pose is not rigid or whose K is not that of a pinhole; -1 if all are valid."""

def camera_to_models(
    camera_to_world: Tensor,  # [B, 4, 4] float32
    model_to_world: Tensor,  # [B, M, 4, 4] float32
    out: Tensor,  # [B, M, 4, 4] float32
) -> None:
    """Write the pose of each row's camera in the frame of each of its parts, computed in double precision."""

def first_bad_part(
    models: Tensor,  # [B, M] int64, -1 for none
    model_to_world: Tensor,  # [B, M, 4, 4] float32
    count: int,  # number of models
) -> int:
    """Return the first part, in row-major order, whose model does not exist or whose pose is not rigid.

    The part is an index into the flattened [B, M] array; -1 if all parts are valid.
    """

def add_density(
    means: NDArray[np.float64],  # [N, 3], from the corner of the grid, in voxels like all lengths here
    axes: NDArray[np.float64],  # [N, 3, 3], columns: the unit axes of the Gaussian
    scales: NDArray[np.float64],  # [N, 3], standard deviations
    opacities: NDArray[np.float64],  # [N]
    first: NDArray[np.int64],  # [N, 3], the first voxel of the Gaussian's range
    end: NDArray[np.int64],  # [N, 3], one past the last voxel of that range
    extent: float,  # standard deviations at which a Gaussian is cut off
    density: NDArray[np.float32],  # [X, Y, Z], added to
) -> None:
    """Add opacity · exp(−½ d²) to the voxels within reach of each Gaussian.

    d is the distance, in standard deviations, from the mean to the box around the voxel along the Gaussian's axes.
    """

def find_distances(
    solid: NDArray[np.bool_],  # [X, Y, Z]
    resolution: float,  # metres
    distance: NDArray[np.float32],  # [X, Y, Z], written: metres between centres; infinite where nothing is solid
    threads: int,
) -> None:
    """Compute the exact distance from every voxel to the nearest solid one."""

def find_geodesics(
    ways: NDArray[np.uint16],  # [X, Y], bit k tells whether the way from a node to the one at steps[k] is open
    steps: NDArray[np.int64],  # [W, 2], at most 16: to later columns (x > 0), or (0, 1)
    lengths: NDArray[np.float64],  # [W], of steps, metres
    goals: NDArray[np.int64],  # [G], nodes; the node (x, y) has the number x · Y + y
    nearest: NDArray[np.int64],  # [X, Y], the node whose distance each node takes
    away: NDArray[np.float64],  # [X, Y], how much is added to it, metres
    metres: NDArray[np.float32],  # [G, X · Y], written; infinite where there is no path
    threads: int,
) -> None:
    """Compute the lengths of the shortest paths from every node to some goals.

    Ways may be travelled in both directions. A path's length is the sum of its steps, one after the other from the goal
    on, in double precision; the number of threads changes no byte.

    Raises:
        ValueError: for ways that leave the grid, or nodes outside it.
    """

def find_largest_part(
    ways: NDArray[np.uint16],  # [X, Y], as in find_geodesics
    steps: NDArray[np.int64],  # [W, 2]
    nodes: NDArray[np.bool_],  # [X, Y], those that count
    part: NDArray[np.bool_],  # [X, Y], written
) -> None:
    """Mark the nodes of the largest part that ways connect; of equally large ones, that which has the first node."""

def build_levels(
    means: Tensor,  # [N, 3] float32, metres, world frame
    axes: Tensor,  # [N, 3, 3] float32, Σ = A Aᵀ
    opacities: Tensor,  # [N] float32
    sh: Tensor,  # [N, (degree + 1)², 3] float32
    degree: int,
) -> dict[str, NDArray[np.float32] | NDArray[np.uint32]]:
    """Build the tree over a scene, with merged Gaussians in inner nodes; ``renderers/lod.py`` describes the arrays."""

def pack_model(
    means: Tensor,  # [N, 3] float32, metres, the model's own frame
    axes: Tensor,  # [N, 3, 3] float32, Σ = A Aᵀ
    opacities: Tensor,  # [N] float32
    sh: Tensor,  # [N, (degree + 1)², 3] float32
    degree: int,
    levels: dict[str, NDArray[np.float32] | NDArray[np.uint32]] | None,  # from build_levels; None draws every Gaussian
    background: tuple[float, float, float],
    antialiased: bool,
) -> dict[str, NDArray[Any]]:
    """Pack a model as a renderer with this background stores it; ``renderers/packed.py`` describes the arrays.

    Raises:
        ValueError: for levels of other Gaussians.
    """

def flat_scene(
    packed: dict[str, NDArray[Any]],  # the arrays of pack_model, made for this background
    background: tuple[float, float, float],
    antialiased: bool,
    tolerance: float,  # pixels
) -> dict[str, Any]:
    """Convert a model to the layout that ``cuda/render.cu`` reads; ``cuda/tile.h`` describes the arrays.

    Raises:
        ValueError: for arrays that are not those of ``pack_model``.
    """

class Collider:
    """A body and the grid of voxels that it is tested against.

    Queries take the addresses of C-contiguous CPU memory and write to ``out``; they return -1, or the first row that is
    not finite or not a rigid pose.
    """

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
        """Occupancy [X, Y, words]: bit z of a column is the voxel (x, y, z). Read-only, like ``distance``."""
    @property
    def distance(self) -> NDArray[np.uint16]:
        """Distance [X, Y, Z] from each voxel to the nearest solid one, in 1/256 of a voxel."""
    @property
    def shape(self) -> tuple[float, float, float, float, float, float, float]:
        """The body, grown so that touches count: half extents, half length, radius, inner and outer radius, voxels."""
    def collides(self, poses: int, out: int, count: int, threads: int, /) -> int: ...  # [B, 4, 4] float32 -> bool
    def free_fraction(self, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...  # -> float32
    def sweeps(self, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...  # -> bool
    def clearance(self, points: int, out: int, count: int, threads: int, /) -> int: ...  # [B, 3] float32 -> float32

class Colliders:
    """A body and several grids to test it against; the caller keeps their ``Collider`` objects alive.

    Queries are those of ``Collider``, with one more argument in front: the address of [B] int64, the index of each
    row's grid. A row whose grid does not exist is rejected in the same way as one with an invalid pose.
    """

    def __init__(self, colliders: list[Collider]) -> None: ...
    def collides(self, places: int, poses: int, out: int, count: int, threads: int, /) -> int: ...
    def free_fraction(self, places: int, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...
    def sweeps(self, places: int, start: int, end: int, out: int, count: int, threads: int, /) -> int: ...
    def clearance(self, places: int, points: int, out: int, count: int, threads: int, /) -> int: ...

class RayCaster:
    """Casts beams against a grid of voxels; poses and beams must be finite, and beams must be unit vectors."""

    def __init__(
        self,
        room: NDArray[np.uint8],  # [Z, X, Y], see ``splatrl.collision.rays.room_around``
        corner: tuple[float, ...],  # of the grid, metres
        resolution: float,  # metres
    ) -> None: ...
    def ranges(
        self,
        poses: int,  # address of [B, 4, 4] float32
        beams: int,  # address of [R, 3] float32, in the frames of the poses
        out: int,  # address of [B, R] float32, metres
        count: int,
        along: int,
        reach: float,
        threads: int,
        /,
    ) -> int:
        """Write the range of each beam, at most ``reach``; return -1, or the first row that is not a rigid pose."""

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
        model: int,
        means: Tensor,  # [N, 3] float32, metres, the model's own frame
        axes: Tensor,  # [N, 3, 3] float32, columns: the axes of the Gaussian times its standard deviations
        opacities: Tensor,  # [N] float32
        sh: Tensor,  # [N, (degree + 1)², 3] float32
        degree: int,
        levels: dict[str, NDArray[np.float32] | NDArray[np.uint32]] | None,  # from build_levels; None: every Gaussian
    ) -> None:
        """Add or replace a model. Several threads may do so at once, but none while another draws.

        Raises:
            ValueError: for levels of other Gaussians.
        """

    def put_model(
        self,
        model: int,
        arrays: dict[str, NDArray[Any]] | None,  # from pack_model with this background; None removes the model
    ) -> None:
        """Replace or remove a model. Not to be called while another thread draws.

        Raises:
            ValueError: for arrays that are not those of ``pack_model``.
        """

    def needs(
        self,
        bounds: NDArray[np.float32],  # [N, 6], the root bounds of models in one frame
        errors: NDArray[np.float32],  # [N], metres, the largest error of the nodes that end the top of each tree
        camera_to_models: Tensor,  # [B, 4, 4] float32
        K: Tensor,  # [B, 3, 3] float32
        width: int,
        height: int,
        out: NDArray[np.uint8],  # [B, N], written: 0 for nothing, 1 for the top of its tree, 2 for the whole model
    ) -> None:
        """Determine what each camera needs of the models that it may see."""

    def render(
        self,
        models: Tensor | None,  # [B, M] int64, -1 for none; None draws model 0 in each row, and M = 1
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
    """Renders views of Gaussians that are being fitted, and back-propagates gradients to their parameters.

    ``values`` is [R, C] float32, aligned to 64 bytes, with C a multiple of 16. Its rows are means, log-scales,
    quaternions (wxyz, of any length), opacity logits, and harmonics by coefficient and colour; R is 14, 23, 38 or 59
    for degrees 0 to 3. The first ``count`` columns are drawn, antialiased, on black, unless they are nearer than
    ``near`` (at least 0.01). Each view is drawn by a single thread, so results do not depend on ``threads``. Not to be
    used by several threads at once.
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
        agreement: Tensor,  # [V, H, W] float32, written: the weighted sum of max(0, 1 - |depth · known - 1|)
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
        slopes: Tensor,  # [V, H, W, 5] float32, gradients by red, green, blue, agreement and alpha
        gradients: Tensor,  # [V, R, C] float32, written up to count
        pose_slopes: Tensor,  # [V, 6] float32, written: by a rotation about the camera, then a translation; world axes
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
        chosen: Tensor,  # [V] int64, index of the photo that each view is compared with
        exposure: Tensor,  # [N, 3, 2] float32, gain and offset of each channel
        ssim_weight: float,
        depth_weight: float,
        gradients: Tensor,  # [V, R, C] float32, written up to count
        losses: Tensor,  # [V, 16] float32, written: total, L1, SSIM, depth, gradients by exposure and pose
        threads: int,
    ) -> None:
        """Compare views with photos by the loss (1 - w) L1 + w (1 - SSIM) + depth weight · (1 - agreement)."""

    def update(
        self,
        values: Tensor,
        gradients: Tensor,  # [V, R, C] float32, averaged over the views
        first: Tensor,  # [R, C] float32, first moments, updated
        second: Tensor,  # [R, C] float32, second moments, updated
        rates: Tensor,  # [R] float32
        step: int,  # from 1
        beta1: float,
        beta2: float,
        epsilon: float,
        opacity_slope: float,  # gradient of the regulariser by each opacity
        scale_slope: float,  # gradient of the regulariser by each standard deviation
        noise: float,  # strength of the noise on means: times the covariance, for transparent Gaussians
        seed: int,
        threads: int,
    ) -> None:
        """Take one step of Adam on ``values``, with regularisers and noise."""

def sweep(
    grey: Tensor,  # [N, H, W] float32, photos
    camera_to_world: Tensor,  # [N, 4, 4] float32
    K: Tensor,  # [3, 3] float32
    rows: Tensor,  # [R] int64, the photos whose depth is wanted
    neighbours: Tensor,  # [R, M] int64, the photos that each is compared with; the first -1 ends a list
    ranges: Tensor,  # [R, 2] float32, smallest and largest inverse depth
    soundings: Tensor,  # [S, 3] float32, photo by photo: column, row and inverse depth of points of known depth
    firsts: Tensor,  # [N + 1] int64, where the soundings of each photo begin
    depths: int,  # number of inverse depths that are tried, a multiple of 16
    out: Tensor,  # [N, H, W] float32, inverse depths; written where a photo has neighbours
    threads: int,
) -> None:
    """Estimate inverse depths of photos by plane sweep and semi-global matching.

    The plane sweep correlates windows of 5×5 pixels, and counts the three neighbours that match best.

    Raises:
        ValueError: for the index of a photo that does not exist, or an invalid number of depths.
    """

def agree(
    inverse: Tensor,  # [N, H, W] float32, inverse depths, 0 where there is none
    camera_to_world: Tensor,  # [N, 4, 4] float32
    K: Tensor,  # [3, 3] float32
    rows: Tensor,  # [R] int64
    neighbours: Tensor,  # [R, M] int64, the photos that each is checked against; the first -1 ends a list
    tolerance: float,  # relative difference of depths that agree
    least: int,  # minimum number of neighbours that must agree
    out: Tensor,  # [N, H, W] float32, written in ``rows``: the mean with those that agree, 0 where too few do
    threads: int,
) -> None:
    """Keep only those depths of photos that enough neighbouring photos confirm."""

def pool_images(
    images: int,  # address of [N, H, W, C], uint8 or float32
    shape: tuple[int, int, int, int],
    side: int,  # of a cell, pixels
    floats: bool,  # whether the images are float32 in [0, 1]
    out: int,  # address of [N, H // side, W // side, C] float32, written
    /,
) -> None:
    """Average images over square cells, and map the result to [−0.5, 0.5]; all memory is C-contiguous.

    Raises:
        ValueError: for a side that is not from 1 to 4096.
    """

def change_appearance(
    pixels: Tensor,  # [B, H, W, 3] uint8
    weights: Tensor,  # [B, K] float32, of a blur: for the pixel itself, then for those 1, 2, ... away on both sides
    gain: Tensor,  # [B, 3] float32, of each colour
    offset: Tensor,  # [B, 3] float32, added to each colour, in units of a byte's range 0 to 255
    grain: Tensor,  # [B] float32, standard deviation of the noise, in the same units
    noise: Tensor | None,  # [B, H, 3 W] float32, with standard deviation 1
    out: Tensor,  # [B, H, W, 3] uint8, written
    threads: int,
) -> None:
    """Blur images, change their colours and add noise.

    Raises:
        ValueError: for tensors whose sizes do not match.
    """

def put_into_weather(
    pixels: Tensor,  # [B, H, W, 3] uint8
    tint: Tensor,  # [B, 3] float32, gains of the light
    veil: Tensor,  # [B, 3] float32, colour of the fog
    left: Tensor | None,  # [B, H, W] float32, fraction of the light that the fog transmits; None without fog
    far: Tensor | None,  # [B, H, W] float32, depth in metres; None if unknown
    falling: tuple[Tensor, ...] | None,  # pattern of rain and snow, and the fields of ``Falling`` (weather_images.py)
    lens: tuple[Tensor, ...] | None,  # pattern of drops, and the fields of ``Wet`` (weather_images.py)
    out: Tensor,  # [B, H, W, 3] uint8, written
    threads: int,
) -> None:
    """Render light, fog, rain, snow and drops on the lens into images.

    Raises:
        ValueError: for tensors whose sizes do not match.
    """

def trunk_forward(
    shape: tuple[int, ...],  # height, width and channels of images; channels of the two convolutions; features
    images: int,  # address of [count, height, width, channels]
    count: int,
    weights: tuple[int, ...],  # addresses of weights and bias of each layer, in PyTorch's order
    layers: tuple[int, ...],  # addresses of [count, rows, columns, channels] twice and [count, features], written
    threads: int,
    /,
) -> None:
    """Run two convolutions without padding (kernels of 4 and 3 pixels, stride 2) and a dense layer, each with a ReLU.

    Addresses are those of C-contiguous float32 arrays in main memory.

    Raises:
        ValueError: for images with fewer than 8 pixels per side, or convolution channels that are not multiples of 16.
    """

def trunk_backward(
    shape: tuple[int, ...],
    images: int,
    count: int,
    weights: tuple[int, ...],
    layers: tuple[int, ...],  # as ``trunk_forward`` wrote them
    slopes: int,  # address of [count, features], the gradient of the features
    gradients: tuple[int, ...],  # addresses of the results, in the order and with the shapes of the weights
    threads: int,
    /,
) -> None:
    """Compute the gradients of the weights of ``trunk_forward``."""

def gru_forward(
    sizes: tuple[int, int, int, int],  # frames, episodes, features, memory
    known: tuple[int, ...],  # addresses of first frames [episodes] int64, and of states before them [episodes, memory]
    features: int,  # address of [frames, features]
    weights: tuple[int, ...],  # addresses of a GRU's weights and biases, in the order of ``nn.GRU``
    made: tuple[int, ...],  # addresses of hidden [frames, memory] and of what to keep [frames, 5 * memory], written
    threads: int,
    /,
) -> None:
    """Run a gated recurrent unit through the frames of episodes, one episode after another.

    Addresses are those of C-contiguous arrays in main memory, of float32 unless stated otherwise.

    Raises:
        ValueError: for sizes of features or memory that are not multiples of 16, or first frames that do not ascend.
    """

def gru_backward(
    sizes: tuple[int, int, int, int],
    known: tuple[int, ...],
    features: int,
    weights: tuple[int, ...],
    made: tuple[int, ...],  # addresses of what ``gru_forward`` kept, and of the gradient of hidden
    gradients: tuple[int, ...],  # addresses of the results: gradients of the weights, then of the features
    threads: int,
    /,
) -> None:
    """Compute the gradients of the weights and features of ``gru_forward``."""

def policy_loss(
    frames: tuple[int, ...],  # addresses of hidden, action (int64), log_prob, advantage and value_target, [count, ...]
    sizes: tuple[int, int, int],  # count, features, actions
    heads: tuple[int, ...],  # addresses of weights and bias of the policy's and of the value's linear layer
    clip_epsilon: float,
    critic_coeff: float,
    entropy_coeff: float,
    gradients: tuple[int, ...],  # addresses of the results: gradients of the heads, then of hidden
    statistics: int,  # address of [5], written: ``splatrl.training.loss.STATISTICS``
    /,
) -> None:
    """Compute the gradients of the loss of proximal policy optimisation (PPO) over discrete actions.

    Addresses are those of C-contiguous float32 arrays in main memory.

    Raises:
        ValueError: for an action that does not exist.
    """

def adam(
    tensors: list[tuple[int, ...]],  # addresses of each tensor's values, gradient, first and second moment
    counts: list[int],  # number of values in each tensor
    step: float,  # from 1
    rate: float,
    beta1: float,
    beta2: float,
    epsilon: float,
    max_norm: float,
    /,
) -> None:
    """Clip the joint norm of the gradients of all tensors, and take a step of Adam."""

class StepTable:
    """Precomputed steps on a lattice, by state and action; states are numbered in C order.

    Args:
        shape: number of values of each index of a state.
        next: number of the state that each step leads to.
        free_fraction: see ``Move``.
        reward: see ``Verdict``, as for ``terminated`` and ``outcome``.
        poses: body-to-world pose of each state.

    Raises:
        ValueError: for tables of other sizes, or a number that is not that of a state.
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
        found: list[int],  # addresses of the results: the same without action, then outcome, free_fraction, reward,
        # success, done, terminated, truncated and [count, 4, 4] poses
        count: int,
        rows: int,  # address of [count] int64, the rows of the batch that step; 0 for all
        max_steps: int,
        goals_for_success: int,
        curriculum: tuple[int, int, int, int, int, int],  # addresses of the curriculum's progress [3] int64 and cohort
        # [B] bool, which are updated; B, levels, window, and the number of successes that promotes
        /,
    ) -> bool:
        """Look up the step of each row, and count steps, returns and goals as ``SplatEnv`` does.

        Returns False, and writes nothing, if a state or an action is not on the lattice. Addresses are those of
        C-contiguous memory with the types of the env.
        """

    def begin(
        self,
        old: list[int],  # addresses of state [count, D], and step_count, episode_return, level, goals, outcome,
        # free_fraction, success, done, terminated, truncated [count]
        found: list[int],  # addresses of the results: the same, and [some, 4, 4] poses
        count: int,
        rows: int,  # address of [some] int64, the rows in which episodes begin, ascending
        some: int,
        uniform: int,  # address of [count] float64 in [0, 1), the random numbers that select the starts
        starts: int,  # address of [available, D] int64
        available: int,
        curriculum: tuple[int, int, int, int, int, int],  # see ``step``
        /,
    ) -> None:
        """Copy the entries of a batch, and begin new episodes in some of its rows.

        Raises:
            ValueError: for a row outside the batch, or a start that is not on the lattice.
        """

def with_rows(
    tensors: list[tuple[int, int, int, int]],  # addresses of old, fresh and written values, and size of the last, bytes
    rows: int,  # address of [some] int64
    some: int,
    count: int,  # rows of the old and of the written values
    /,
) -> None:
    """Copy tensors, with some rows replaced by fresh ones; all memory is C-contiguous.

    Raises:
        ValueError: for a row outside the batch.
    """

class RowIndex:
    """Maps rows of bytes to numbers, from 0 in the order in which they are added.

    Each column is given by its address, its bytes per row, and its stride from one row to the next in bytes.
    """

    def __init__(self) -> None: ...
    def find(
        self,
        columns: list[tuple[int, int, int]],
        count: int,  # rows
        out: int,  # address of [count] int64, written: numbers, or −1 − i for a row equal to the i-th that is returned
        /,
    ) -> list[int]:
        """Look up the number of each row, and return the rows that have none, without duplicates."""

    def add(self, columns: list[tuple[int, int, int]], rows: list[int], /) -> None:
        """Give the next numbers to rows that have none."""

    def __len__(self) -> int: ...
