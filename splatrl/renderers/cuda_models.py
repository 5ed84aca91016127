"""The models of a renderer as CUDA kernels read them: one after another in the same arrays."""

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.native import _core
from splatrl.native.cuda.kernels import uploaded
from splatrl.renderers.base import gaussians_of
from splatrl.renderers.lod import gaussian_arrays, levels_for
from splatrl.scenes.cache import Arrays
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene

MOST_INDICES = 2**24
"""The most Gaussians, merged ones included, that the index in a key can address."""
MOST_CLUSTERS = 2**25
"""The most nodes of all models' trees: as many as ``Node`` of cuda/candidates.h can address."""


class _SceneArrays(ctypes.Structure):
    """``SceneArrays`` of cuda/tile.h, where all members are described."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("spheres", "indices", "shapes", "colors", "clusters", "group_bounds")),
        ("background", ctypes.c_float * 3),
        ("tolerance", ctypes.c_float),
    )


class Model(NamedTuple):
    """``Model`` of cuda/places.h: where one model lies in the arrays of all."""

    root: int
    first_index: int
    size: int
    gaussians: int


class CudaModels:
    """Models on a device, with everything that kernels need to know about them.

    Args:
        scenes: the models.
        antialiased: whether images are antialiased.
        background: colour behind the Gaussians.
        tolerance: pixels by which level of detail may displace what is shown; 0 renders every Gaussian.
        device: where they are kept.

    Attributes:
        arrays: what kernels take for ``SceneArrays``.
        models: where each one lies in the arrays.
        table: [models, 4] int32 on the device, the same.
        clusters: how many the largest tree has.
        gaussians: how many the largest model has, merged ones not counted.

    Raises:
        ValueError: for Gaussians that are not finite or too many, or a tolerance that is negative or not finite.
    """

    def __init__(
        self,
        scenes: Sequence[Scene | Gaussians],
        antialiased: bool,
        background: tuple[float, float, float],
        tolerance: float,
        device: torch.device,
    ) -> None:
        degree, flats = degree_of(scenes), list[dict[str, Any]]()
        self.models, self.clusters = list[Model](), 0
        slots = clusters = indices = 0
        for scene in scenes:
            arrays, levels = _of_degree(degree, scene, tolerance)
            flat = _core.flat_scene(
                **arrays,
                degree=degree,
                background=background,
                levels=levels,
                antialiased=antialiased,
                tolerance=tolerance,
                first_slot=slots,
                first_cluster=clusters,
            )
            size = len(flat["shapes"])
            self.models.append(Model(clusters, indices, size, gaussians_of(scene).numel()))
            self.clusters = max(self.clusters, len(flat["clusters"]))
            slots, clusters, indices = slots + len(flat["indices"]), clusters + len(flat["clusters"]), indices + size
            values = {"background": background, "tolerance": flat.pop("tolerance")}
            flats.append(flat)
        _require_room(self.models, clusters)
        self.gaussians = max(model.gaussians for model in self.models)
        self.table = torch.tensor(self.models, dtype=torch.int32, device=device)
        self._kept = {name: uploaded(_joined(flats, name), device) for name in flats[0]}
        self.arrays = _SceneArrays(**{name: value.data_ptr() for name, value in self._kept.items()}, **values)


def _require_room(models: Sequence[Model], clusters: int) -> None:
    """Refuse models with more Gaussians or tree nodes than keys and nodes have bits to number."""
    sizes = [model.size for model in models]
    if max(sizes) > MOST_INDICES:
        number, most = sizes.index(max(sizes)), f"{MOST_INDICES:,} Gaussians, merged ones included"
        raise ValueError(f"scene[{number}]: expected at most {most}, got {max(sizes):,}")
    if clusters > MOST_CLUSTERS:
        raise ValueError(
            f"scene: expected at most {MOST_CLUSTERS:,} nodes in the trees of all models, got {clusters:,}"
        )


def degree_of(scenes: Sequence[Scene | Gaussians]) -> int:
    """The largest degree of any model's harmonics, which kernels are compiled for."""
    return max(gaussians_of(scene).sh_degree for scene in scenes)


def _of_degree(degree: int, scene: Scene | Gaussians, tolerance: float) -> tuple[dict[str, Tensor], Arrays | None]:
    """A model and its levels of detail, with harmonics padded by zeros up to a degree."""
    arrays = gaussian_arrays(gaussians_of(scene))
    levels, harmonics = levels_for(scene, arrays, tolerance), arrays["sh"].shape[1]
    missing = (degree + 1) ** 2 - harmonics
    if missing > 0:
        arrays = arrays | {"sh": torch.nn.functional.pad(arrays["sh"], (0, 0, 0, missing))}
        if levels is not None:
            levels = levels | {"sh": _padded(levels["sh"], harmonics, missing)}
    return arrays, levels


def _padded(sh: NDArray[np.float32], harmonics: int, missing: int) -> NDArray[np.float32]:
    """Flat colours of ``harmonics`` coefficients each, with ``missing`` zeros appended to each."""
    return np.pad(sh.reshape(-1, harmonics, 3), ((0, 0), (0, missing), (0, 0))).reshape(-1)


def _joined(flats: Sequence[Mapping[str, NDArray[Any]]], name: str) -> NDArray[Any]:
    """One array of all models, without a copy where there is one model."""
    return flats[0][name] if len(flats) == 1 else np.concatenate([flat[name] for flat in flats])
