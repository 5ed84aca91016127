"""Forward and backward passes of a fit on a GPU: the methods of ``_core.Fitter``, for tensors on a device."""

import ctypes
from typing import NamedTuple

import torch
from torch import Tensor

from splatrl.capture.fitting.structs import (
    BACK_BYTES,
    BLEND_BYTES,
    CHANNELS,
    COMPARE_BYTES,
    PAIR_MOMENTS,
    PULL_BYTES,
    ROWS,
    SPLAT_FLOATS,
    SUMS,
    THREADS,
    TILE,
    FitModel,
    FitPairs,
    FitPhotos,
    FitUpdate,
    FitViews,
    kernel_defines,
)
from splatrl.native.cuda.kernels import CudaKernels, Kernels, Load


class _Drawn(NamedTuple):
    """Rendered views and what their backward pass needs; keeps the tensors behind the raw addresses alive."""

    kernels: Kernels
    model: FitModel
    views: FitViews
    pairs: FitPairs
    pair_count: int
    image: Tensor  # [V, CHANNELS, H, W]
    tiles: int
    blocks: int  # thread blocks over the Gaussians of all views
    kept: tuple[Tensor, ...]


class CudaFitter:
    """Renders views of Gaussians and backpropagates to their parameters, as ``_core.Fitter`` does on a CPU.

    Parameters, gradients, moments, photos and known depths must be on the device; poses, intrinsics, exposures,
    learning rates and losses may be anywhere, because they are small. ``values`` have harmonics up to degree 3. Each
    call that renders reads the total length of the tile lists back to the host. The same input gives a bit-identical
    result: no sum depends on the order of threads. The first call compiles the kernels, once per machine, in seconds,
    and caches them; it raises ``ImportError`` where the extra ``cuda`` is not installed.

    Args:
        device: a CUDA device.
        load: loads the kernels; None compiles them for ``device``.

    Attributes:
        device: the device that the model must be on.
    """

    def __init__(self, device: torch.device | str, load: Load | None = None) -> None:
        self.device = torch.empty(0, device=device).device  # includes the device index
        self._load = load or (lambda source, defines: CudaKernels(source, self.device, defines))
        self._kernels: dict[int, Kernels] = {}

    def render(
        self,
        values: Tensor,
        count: int,
        near: float,
        camera_to_world: Tensor,
        K: Tensor,
        known: Tensor,
        rgb: Tensor,
        agreement: Tensor,
        alpha: Tensor,
        threads: int = 1,
    ) -> None:
        """Render views: see ``_core.Fitter.render``."""
        image = self._draw(values, count, near, camera_to_world, K, known, None).image
        rgb.copy_(image[:, :3].movedim(1, -1))
        agreement.copy_(image[:, 3])
        alpha.copy_(image[:, 4])

    def pull(
        self,
        values: Tensor,
        count: int,
        near: float,
        camera_to_world: Tensor,
        K: Tensor,
        known: Tensor,
        slopes: Tensor,
        gradients: Tensor,
        pose_slopes: Tensor,
        threads: int = 1,
    ) -> None:
        """Backpropagate gradients of the images to parameters and poses: see ``_core.Fitter.pull``."""
        drawn = self._draw(values, count, near, camera_to_world, K, known, None)
        pose_slopes.copy_(self._pull(drawn, self._here(slopes).movedim(-1, 1).contiguous(), gradients))

    def compare(
        self,
        values: Tensor,
        count: int,
        near: float,
        camera_to_world: Tensor,
        K: Tensor,
        pixels: Tensor,
        known: Tensor,
        chosen: Tensor,
        exposure: Tensor,
        ssim_weight: float,
        depth_weight: float,
        gradients: Tensor,
        losses: Tensor,
        threads: int = 1,
    ) -> None:
        """Compare views with photos: see ``_core.Fitter.compare``."""
        drawn = self._draw(values, count, near, camera_to_world, K, known, chosen)
        views, height, width = len(chosen), *pixels.shape[1:3]
        light = self._here(exposure[chosen.to(exposure.device)])
        curves = self._empty(views, 3, 3, height, width)
        slopes, sums = torch.empty_like(drawn.image), self._empty(views, drawn.tiles, 3, SUMS)
        addresses = map(self._address, (pixels, light, drawn.image, curves, slopes, sums))
        photos = FitPhotos(*addresses, ssim_weight, depth_weight)
        for kernel in ("curve_views", "slope_views"):
            drawn.kernels.launch(
                kernel, 3 * views * drawn.tiles, THREADS, drawn.views, photos, shared=COMPARE_BYTES
            )  # fmt: skip
        poses = self._pull(drawn, slopes, gradients)
        parts = torch.cat([sums.sum(1, dtype=torch.float64).flatten(1), poses], 1)
        found, turns = _read(parts, losses.device).split([3 * SUMS, 6], 1)
        apart, by_gain, by_offset, depth, similar = found.view(views, 3, SUMS).unbind(-1)  # [V, 3]
        l1, ssim = apart.sum(1) / (3 * height * width), similar.sum(1) / (3 * height * width)
        unknown = depth[:, 0] / (height * width)
        total = (1 - ssim_weight) * l1 + ssim_weight * (1 - ssim) + depth_weight * unknown
        by_exposure = torch.stack([by_gain, by_offset], -1).flatten(1)
        losses.copy_(torch.cat([torch.stack([total, l1, ssim, unknown], 1), by_exposure, turns], 1))

    def update(
        self,
        values: Tensor,
        gradients: Tensor,
        first: Tensor,
        second: Tensor,
        rates: Tensor,
        step: int,
        beta1: float,
        beta2: float,
        epsilon: float,
        opacity_slope: float,
        scale_slope: float,
        noise: float,
        seed: int,
        threads: int = 1,
    ) -> None:
        """Take a step of Adam, and add the noise of MCMC: see ``_core.Fitter.update``."""
        rows, stride = values.shape
        here = self._here(rates)
        update = FitUpdate(
            *map(self._address, (values, gradients)), len(gradients), *map(self._address, (first, second, here)),
            rows, stride, beta1, beta2, epsilon, _correction(beta1, step), _correction(beta2, step),
            opacity_slope, scale_slope, noise, seed,
        )  # fmt: skip
        self._kernels_for(values).launch("take_step", -(-stride // THREADS), THREADS, update)

    def _draw(
        self,
        values: Tensor,
        count: int,
        near: float,
        camera_to_world: Tensor,
        K: Tensor,
        known: Tensor,
        photos: Tensor | None,
    ) -> _Drawn:
        """Render views; ``photos`` holds the index of each view's known depths, None takes them in order."""
        kernels, stride = self._kernels_for(values), values.shape[1]
        count_views, (height, width) = len(camera_to_world), known.shape[1:]
        poses, lenses = self._here(camera_to_world), self._here(K)
        rows = (torch.arange(count_views) if photos is None else photos).to(self.device, torch.int64)
        model = FitModel(self._address(values), stride, count, ROWS.index(len(values)), near)
        addresses = map(self._address, (poses, lenses, rows, known))
        views = FitViews(*addresses, count_views, width, height)
        tiles, blocks = -(-width // TILE) * -(-height // TILE), count_views * -(-stride // THREADS)
        splats = self._empty(count_views * stride, SPLAT_FLOATS)
        counts = torch.empty(count_views * stride, dtype=torch.int32, device=self.device)
        pairs = FitPairs(splats.data_ptr(), counts.data_ptr())
        kernels.launch("project_views", blocks, THREADS, model, views, pairs)
        ends = counts.cumsum(0)
        total = int(_read(ends[-1:], torch.device("cpu")))
        keys = torch.empty(total, dtype=torch.int64, device=self.device)
        owners = torch.empty(total, dtype=torch.int32, device=self.device)
        pairs.ends, pairs.keys, pairs.owners = ends.data_ptr(), keys.data_ptr(), owners.data_ptr()
        kernels.launch("list_tiles", blocks, THREADS, model, views, pairs)
        ordered, order = keys.sort(stable=True)
        bounds = torch.arange(count_views * tiles + 1, device=self.device) << 32
        starts = torch.searchsorted(ordered, bounds)
        taken = torch.empty(count_views * tiles, dtype=torch.int32, device=self.device)
        pairs.order, pairs.starts, pairs.taken = order.data_ptr(), starts.data_ptr(), taken.data_ptr()
        image = self._empty(count_views, CHANNELS, height, width)
        kernels.launch("blend_views", count_views * tiles, THREADS, views, pairs, image, shared=BLEND_BYTES)
        kept = (values, poses, lenses, rows, known, splats, counts, ends, keys, owners, order, starts, taken)
        return _Drawn(kernels, model, views, pairs, total, image, tiles, blocks, kept)

    def _pull(self, drawn: _Drawn, slopes: Tensor, gradients: Tensor) -> Tensor:
        """Write the gradients of the parameters; return those of the poses, [V, 6] float64."""
        moments = torch.zeros(drawn.pair_count, PAIR_MOMENTS, device=self.device)
        count = len(slopes)
        poses = self._empty(drawn.blocks, 6)
        drawn.kernels.launch(
            "blend_views_back", count * drawn.tiles, THREADS, drawn.views, drawn.pairs, drawn.image, slopes, moments,
            shared=BACK_BYTES,
        )  # fmt: skip
        drawn.kernels.launch(
            "pull_views", drawn.blocks, THREADS, drawn.model, drawn.views, drawn.pairs, moments, gradients, poses,
            shared=PULL_BYTES,
        )  # fmt: skip
        return poses.view(count, -1, 6).sum(1, dtype=torch.float64)

    def _kernels_for(self, values: Tensor) -> Kernels:
        if len(values) not in ROWS:
            raise ValueError(f"values: expected {', '.join(map(str, ROWS[:-1]))} or {ROWS[-1]} rows, got {len(values)}")
        degree = ROWS.index(len(values))
        if degree not in self._kernels:
            self._kernels[degree] = self._load("fit", kernel_defines(degree))
        return self._kernels[degree]

    def _address(self, tensor: Tensor) -> int:
        assert tensor.device == self.device and tensor.is_contiguous(), (tensor.device, tensor.stride())
        return tensor.data_ptr()

    def _here(self, values: Tensor) -> Tensor:
        return values.detach().to(self.device, torch.float32).contiguous()

    def _empty(self, *shape: int) -> Tensor:
        return torch.empty(shape, device=self.device)


def _read(values: Tensor, device: torch.device) -> Tensor:
    """Copy values to another device; this waits for the GPU where they come from one."""
    return values.to(device)


def _correction(beta: float, step: int) -> float:
    """Return Adam's bias correction for moments that began at 0, with the rate in the kernel's single precision."""
    return 1.0 / (1.0 - float(ctypes.c_float(beta).value) ** step)
