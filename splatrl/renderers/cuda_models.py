"""The models of a renderer as CUDA kernels read them: concatenated in the same arrays."""

import ctypes
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatrl.native import _core
from splatrl.native.cuda.kernels import uploaded
from splatrl.renderers.base import gaussians_of
from splatrl.renderers.cuda_trees import CLUSTER, Tree, joined, moved
from splatrl.renderers.lod import checked_tolerance, gaussian_arrays, levels_for
from splatrl.renderers.packed import packed_arrays
from splatrl.renderers.packed_blocks import Packing, for_each_block
from splatrl.scenes.blocks import Block, BlockScene
from splatrl.scenes.cache import Arrays
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene

MOST_INDICES = 2**28
"""The most Gaussians, merged ones included, that the index in a key can address: ``INDEX_BITS`` of cuda/tile.h."""
MOST_CLUSTERS = 2**25
"""The most nodes in the trees of all models together: as many as ``Node`` of cuda/candidates.h can address."""
GROUP = 16
"""Slots per group; each node has several groups."""


class _SceneArrays(ctypes.Structure):
    """``SceneArrays`` of cuda/tile.h, which describes the members."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("spheres", "indices", "shapes", "colors", "clusters", "group_bounds")),
        ("background", ctypes.c_float * 3),
        ("tolerance", ctypes.c_float),
    )


class Model(NamedTuple):
    """``Model`` of cuda/places.h: the position of one model in the arrays of all."""

    root: int
    first_index: int
    size: int
    gaussians: int


class Packer:
    """Packs the models of a renderer, all with harmonics of the highest degree among them.

    Args:
        scenes: the models; blocks that are not cached yet are packed into the cache in parallel.
        antialiased: whether images are antialiased.
        background: colour behind the Gaussians.
        tolerance: pixels by which level of detail may displace what is shown; 0 renders every Gaussian.

    Attributes:
        sh_degree: the highest degree among the models.

    Raises:
        ValueError: for Gaussians that cannot be drawn, or a tolerance that is negative or not finite.
    """

    def __init__(
        self,
        scenes: Sequence[Scene | Gaussians],
        antialiased: bool,
        background: tuple[float, float, float],
        tolerance: float,
    ) -> None:
        self.scenes, self.antialiased, self.background = scenes, antialiased, background
        self.tolerance = checked_tolerance(tolerance)
        self._packing = Packing(tolerance > 0.0, background, antialiased)
        self._degrees = {block: degree for scene in scenes for block, degree in self._degrees_of(scene)}
        whole = [gaussians_of(scene).sh_degree for scene in scenes if not isinstance(scene, BlockScene)]
        self.sh_degree = max([*whole, *self._degrees.values()])

    def _degrees_of(self, scene: Scene | Gaussians) -> Iterator[tuple[Block, int]]:
        """Yield the degree of each block of a scene, which packs the block if necessary."""
        if isinstance(scene, BlockScene):
            files = [f"packed-{self._packing.name(block)}" for block in scene.blocks]
            yield from zip(scene.blocks, for_each_block(self._degree_of, scene.blocks, files), strict=True)

    def _degree_of(self, block: Block) -> int:
        return math.isqrt(self._packing.packed(block)["colors"].shape[1] // 3) - 1

    def packed(self, scene: Scene | Gaussians) -> Iterator[Arrays]:
        """Yield a model as ``packed_model`` packs it, or a scene in blocks block by block."""
        if isinstance(scene, BlockScene):
            for block in scene.blocks:
                more = self._degrees[block] < self.sh_degree
                packing = replace(self._packing, sh_degree=self.sh_degree) if more else self._packing
                yield packing.packed(block)
        else:
            arrays = gaussian_arrays(gaussians_of(scene))
            levels = levels_for(scene, arrays, self.tolerance)
            yield packed_arrays(arrays, levels, self.sh_degree, self.background, self.antialiased)


class CudaModels:
    """Models on a device, with everything that kernels need to know about them.

    The blocks of a scene form one model: their trees are joined, and their Gaussians are in the order of the blocks.
    While they are uploaded, only one block at a time is in main memory.

    Args:
        packer: packs the models.
        device: the device that holds them.

    Attributes:
        arrays: the ``SceneArrays`` that kernels take.
        models: the position of each model in the arrays.
        table: [models, 4] int32 on the device, the same positions.
        clusters: number of clusters of the largest tree.
        gaussians: number of Gaussians of the largest model, merged ones not counted.

    Raises:
        ValueError: for Gaussians that cannot be drawn, or too many of them.
    """

    def __init__(self, packer: Packer, device: torch.device) -> None:
        self.models, self.clusters = list[Model](), 0
        self._uploaded: dict[str, list[Tensor]] = {}
        self._device, self._slots, self._clusters = device, 0, 0
        for scene in packer.scenes:
            self._add(packer, scene)
        self.gaussians = max(model.gaussians for model in self.models)
        self.table = torch.tensor(self.models, dtype=torch.int32, device=device)
        self._kept = {name: _one(self._uploaded.pop(name)) for name in list(self._uploaded)}
        addresses = {name: value.data_ptr() for name, value in self._kept.items()}
        self.arrays = _SceneArrays(**addresses, background=packer.background, tolerance=self._tolerance)

    def _add(self, packer: Packer, scene: Scene | Gaussians) -> None:
        """Append a model to the others."""
        last = self.models[-1] if self.models else Model(0, 0, 0, 0)
        trees, size, gaussians = list[Tree](), 0, 0
        for packed in packer.packed(scene):
            flat = _core.flat_scene(packed, packer.background, packer.antialiased, packer.tolerance)
            self._tolerance = flat.pop("tolerance")
            clusters = flat.pop("clusters").view(CLUSTER)[:, 0]
            trees.append(Tree(moved(clusters, 0, self._slots // GROUP), flat.pop("group_bounds")))
            flat["indices"] += np.uint32(size)
            size, self._slots = size + len(flat["shapes"]), self._slots + len(flat["indices"])
            gaussians += 1 + int(packed["indices"][: len(packed["geometry"])].max())
            if size > MOST_INDICES:
                most, blocks = f"{MOST_INDICES:,} Gaussians, merged ones included", f" in its first {len(trees)} blocks"
                got = f"{size:,}{blocks if isinstance(scene, BlockScene) else ''}"
                raise ValueError(f"scene[{len(self.models)}]: expected at most {most}, got {got}")
            self._upload(flat)
        tree = joined(trees)
        self.models.append(Model(self._clusters, last.first_index + last.size, size, gaussians))
        clusters = moved(tree.clusters, self._clusters)
        self._upload({"clusters": clusters.view(np.uint8), "group_bounds": tree.group_bounds})
        self._clusters += len(clusters)
        self.clusters = max(self.clusters, len(clusters))
        if self._clusters > MOST_CLUSTERS:
            raise ValueError(f"scene: expected at most {MOST_CLUSTERS:,} nodes in the trees of all models, got more")

    def _upload(self, flat: Arrays) -> None:
        for name, values in flat.items():
            self._uploaded.setdefault(name, []).append(uploaded(values, self._device))


def _one(pieces: list[Tensor]) -> Tensor:
    """Concatenate the pieces of an array, without a copy if there is only one."""
    return pieces[0] if len(pieces) == 1 else torch.cat(pieces)
