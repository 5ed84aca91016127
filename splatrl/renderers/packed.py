"""Models as arrays, in the layout that the renderer for CPUs draws from, to be kept in a file, whole or in part.

The arrays, for C nodes of the tree in preorder and G groups of 16 Gaussians, of which the last M hold merged ones:
    nodes: [C, 3] uint32, first group, number of groups, and the node after all those below it.
    errors: [C] float32, metres by which what a node shows is displaced: 0 in a leaf, infinite if it shows nothing.
    bounds: [C, 6] float32, of everything below a node: centre and radius of a ball around the means, the most standard
        deviations at which any Gaussian is visible, and the largest product of that reach and the longest axis; metres.
    group_bounds: [C, 6, 16] float32, the same for each of the node's groups.
    geometry: [G − M, 10, 16] float32, mean, lower triangular factor of the covariance row by row, and log2 of the
        opacity.
    merged: [M, 448] uint8, the same in half floats, how many Gaussians a merged one stands for, and the sum of their
        opacities: ``MergedGroup`` of native/kernel.h.
    colors: [G, 3 · harmonics, 16] half floats, as uint16.
    indices: [G, 16] uint32, tie-breakers for equal depths.
"""

import heapq
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

from splatrl.native import _core
from splatrl.renderers.lod import build_levels, gaussian_arrays
from splatrl.scenes.cache import Arrays
from splatrl.scenes.gaussians import Gaussians

PACKED_VERSION = 3
"""Version of the arrays. Increment it when they, or how they are made, change: cached arrays are then rebuilt."""

HUGE_PAGE = 2**21


def packed_model(
    gaussians: Gaussians, merge: bool, background: tuple[float, float, float], antialiased: bool, sh_degree: int = 0
) -> Arrays:
    """Pack Gaussians, with a tree over them.

    Args:
        gaussians: N Gaussians, in the frame of the model.
        merge: whether inner nodes hold merged Gaussians, for levels of detail.
        background: the renderer's background colour, which stored colours are relative to.
        antialiased: whether the renderer is antialiased.
        sh_degree: minimum degree of the stored harmonics; lower degrees are padded with zeros.

    Raises:
        ValueError: for Gaussians that cannot be drawn.
    """
    arrays, degree = gaussian_arrays(gaussians), gaussians.sh_degree
    levels = build_levels(arrays, degree) if merge else None
    return packed_arrays(arrays, levels, max(degree, sh_degree), background, antialiased)


def packed_arrays(
    arrays: Mapping[str, Tensor],
    levels: Arrays | None,
    degree: int,
    background: tuple[float, float, float],
    antialiased: bool,
) -> Arrays:
    """Pack ``gaussian_arrays`` and their levels, with harmonics padded to a degree; see ``packed_model``."""
    harmonics = arrays["sh"].shape[1]
    missing = (degree + 1) ** 2 - harmonics
    if missing > 0:
        arrays = {**arrays, "sh": pad(arrays["sh"], (0, 0, 0, missing))}
        if levels is not None:
            sh = levels["sh"].reshape(-1, harmonics, 3)
            levels = levels | {"sh": np.pad(sh, ((0, 0), (0, missing), (0, 0))).reshape(-1)}
    return dict(
        _core.pack_model(**arrays, degree=degree, levels=levels, background=background, antialiased=antialiased)
    )


def packed_bytes(arrays: Arrays) -> int:
    """Return the bytes that a model takes in the core, which keeps large arrays in whole huge pages."""
    sizes = [values.nbytes for values in arrays.values()]
    return sum(size if size <= HUGE_PAGE // 2 else -(-size // HUGE_PAGE) * HUGE_PAGE for size in sizes)


def top_of(arrays: Arrays, groups: int) -> tuple[Arrays, float]:
    """Extract the top of a model's tree, a smaller model that draws the same as long as the cut stays within the top.

    Nodes are opened one by one, the one with the largest error first, until the top is full. Bounds and errors above
    the nodes where the top ends are kept, so that a camera cuts both trees in the same way; the nodes where it ends are
    drawn whenever the cut gets that far.

    Args:
        arrays: the arrays of the whole model, with merged Gaussians.
        groups: the most groups that the top may have; it always has at least those of the root.

    Returns:
        Its arrays, and the largest error of the nodes where it ends, metres: 0 if the top is the whole model.
    """
    nodes, errors = arrays["nodes"].astype(np.int64), arrays["errors"]
    counts, skips = nodes[:, 1], nodes[:, 2]
    kept, opened = {0}, set[int]()
    ends, held = [(-float(errors[0]), 0)], int(counts[0])
    while ends and ends[0][0] < 0.0:
        node = ends[0][1]
        second = int(skips[node + 1])
        below = [node + 1, second] if second < skips[node] else [node + 1]
        held += int(counts[below].sum())
        if held > groups:
            break
        heapq.heappop(ends)
        opened.add(node)
        kept.update(below)
        for child in below:
            heapq.heappush(ends, (-float(errors[child]), child))
    order = np.array(sorted(kept))
    return _part(arrays, order, np.array([node not in opened for node in order])), -ends[0][0]


def _part(arrays: Arrays, order: NDArray[np.int64], ends: NDArray[np.bool_]) -> Arrays:
    """Extract the nodes ``order`` of a tree, with all that they hold; those in ``ends`` become leaves."""
    nodes, own = arrays["nodes"].astype(np.int64), len(arrays["geometry"])
    first, counts, skips = nodes[order].T
    ranges = [np.arange(start, start + count) for start, count in zip(first, counts, strict=True)]
    groups = np.sort(np.concatenate(ranges))
    new_nodes = [np.searchsorted(groups, first), counts, np.searchsorted(order, skips)]
    ranks = np.unique(arrays["indices"][groups], return_inverse=True)[1]  # only their order matters
    part: dict[str, Any] = {
        "geometry": arrays["geometry"][groups[groups < own]],
        "merged": arrays["merged"][groups[groups >= own] - own],
        "colors": arrays["colors"][groups],
    }
    return part | {
        "nodes": np.stack(new_nodes, 1).astype(np.uint32),
        "errors": np.where(ends, np.float32(0.0), arrays["errors"][order]),
        "bounds": arrays["bounds"][order],
        "group_bounds": arrays["group_bounds"][order],
        "indices": ranks.reshape(-1, 16).astype(np.uint32),
    }
